"""Reads OpenEXR files: linear radiance in half or single precision, with the primaries of the attribute `chromaticities`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

from blender_nep.capture.photos.formats.color_encoding import LINEAR, ColorEncoding, from_chromaticities
from blender_nep.capture.photos.formats.raster import MOST_VALUES, Raster, check_values

_SMALL_FRAME, _LARGEST_PART = 1 << 25, 16
"""A display window may have as many pixels as 8K, or else so many times those that are stored: the rest becomes NaN."""


def size(path: Path) -> tuple[int, int]:
    """(width, height)"""
    return _window(OpenEXR.File(str(path), header_only=True).header(), "displayWindow")


def read(path: Path) -> Raster:
    """The first part of the file that has colors."""
    pixels, encoding = _pixels(path)
    return Raster(pixels, encoding, associated=True)


def _color_channels(names: list[str]) -> list[str] | None:
    """The names of the channels R, G, B (or one luminance) in an EXR part, and of A if there is one; None if there is none.

    Channels outside any layer come first, then a layer 'Combined', then any other layer.
    """
    layers = sorted({n.rpartition(".")[0] for n in names}, key=lambda n: (n != "", "combined" not in n.lower(), n))
    for layer in layers:
        prefix = layer + "." if layer else ""
        short = {n[len(prefix) :].upper(): n for n in names if n.rpartition(".")[0] == layer}
        for wanted in ("RGB", "Y"):
            if all(c in short for c in wanted):
                return [short[c] for c in wanted] + ([short["A"]] if "A" in short else [])
    return None


def check(path: Path, most_values: int = MOST_VALUES) -> None:
    """Raises ValueError if the pixels, or the display window around them, would not fit into memory."""
    if not path.is_file():  # OpenEXR would wait for ever for a pipe
        raise OSError(f"there is no file {path}")
    values = 0
    for part in OpenEXR.File(str(path), header_only=True).parts:
        stored, frame = _window(part.header, "dataWindow"), _window(part.header, "displayWindow")
        channels = len(part.header["channels"])
        values += stored[0] * stored[1] * channels
        if values > most_values:
            raise ValueError(f"its pixels are {stored[0]} x {stored[1]} with {channels} channels")
        check_values(*frame, 4)
        if frame[0] * frame[1] > max(_SMALL_FRAME, _LARGEST_PART * stored[0] * stored[1]):
            raise ValueError(f"its frame is {frame[0]} x {frame[1]}, of which it stores {stored[0]} x {stored[1]} pixels")


def _window(header: dict[str, Any], name: str) -> tuple[int, int]:
    """(width, height) of a window. Raises ValueError if it is empty."""
    low, high = header[name]
    width, height = int(high[0]) - int(low[0]) + 1, int(high[1]) - int(low[1]) + 1
    if min(width, height) < 1:
        raise ValueError(f"its {name} is empty")
    return width, height


def _pixels(path: Path) -> tuple[np.ndarray, ColorEncoding]:
    check(path)
    parts = OpenEXR.File(str(path), separate_channels=True).parts
    if not parts:  # OpenEXR has printed why
        raise ValueError("its pixels are damaged")
    for part in parts:
        channels = {n: np.asarray(c.pixels) for n, c in part.channels.items()}
        if not channels:  # the same, for a part after its header
            raise ValueError("its pixels are damaged")
        names = _color_channels(list(channels))
        if names is None:
            continue
        half = all(channels[n].dtype == np.float16 for n in names)
        pixels = np.stack([channels[n] for n in names], -1, dtype=np.float16 if half else np.float32, casting="unsafe")
        low, high = part.header["dataWindow"]
        frame_low, frame_high = part.header["displayWindow"]
        if tuple(low) != tuple(frame_low) or tuple(high) != tuple(frame_high):
            pixels = _place(pixels, np.asarray(low) - frame_low, np.asarray(frame_high) - frame_low + 1)
        places = part.header.get("chromaticities")
        return pixels, LINEAR if places is None else from_chromaticities(places)
    raise ValueError("no R, G, B or Y channels")


def _place(pixels: np.ndarray, corner: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Place an EXR's data window, which begins at corner (x, y), into its display window of size (w, h).

    Pixels that are not stored in the file become NaN.
    """
    out = np.full((int(size[1]), int(size[0]), pixels.shape[-1]), np.nan, pixels.dtype)
    y, x = np.arange(pixels.shape[0]) + int(corner[1]), np.arange(pixels.shape[1]) + int(corner[0])
    rows, columns = (y >= 0) & (y < out.shape[0]), (x >= 0) & (x < out.shape[1])
    out[np.ix_(y[rows], x[columns])] = pixels[np.ix_(rows, columns)]
    return out
