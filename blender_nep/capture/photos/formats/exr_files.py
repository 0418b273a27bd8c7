"""Reads OpenEXR files: linear radiance in half or single precision, with the primaries of the attribute `chromaticities`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenEXR

from blender_nep.capture.photos.formats.color_encoding import LINEAR, ColorEncoding, from_chromaticities
from blender_nep.capture.photos.formats.raster import Raster


def size(path: Path) -> tuple[int, int]:
    """(width, height)"""
    low, high = OpenEXR.File(str(path), header_only=True).header()["displayWindow"]
    return int(high[0] - low[0]) + 1, int(high[1] - low[1]) + 1


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


def _pixels(path: Path) -> tuple[np.ndarray, ColorEncoding]:
    for part in OpenEXR.File(str(path), separate_channels=True).parts:
        channels = {n: np.asarray(c.pixels) for n, c in part.channels.items()}
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
