"""Reads photos as linear radiance: OpenEXR (linear), PNG and JPEG (8 or 16 bits, sRGB unless the capture says linear).

Blender's Python lacks the packages of this file and cannot import it: backend/scene_io/image_size.py is its copy of
`image_size`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import OpenEXR
from PIL import Image

from blender_nep.capture import png16
from blender_nep.color import srgb_to_linear
from blender_nep.errors import CaptureError

SUFFIXES = (".exr", ".png", ".jpg", ".jpeg")


_SRGB_8 = srgb_to_linear(np.arange(256) / 255.0)


def find_image(folder: Path, name: str) -> Path | None:
    """The path of the image `name` in `folder`, or None if there is no such file.

    Where `name` has no extension (as in Blender datasets), the extensions of `SUFFIXES` are tried in their order.
    """
    path = folder / name
    if path.is_file():
        return path
    if path.suffix.lower() not in SUFFIXES:
        for suffix in SUFFIXES:
            for found in (path.with_name(path.name + suffix), path.with_name(path.name + suffix.upper())):
                if found.is_file():
                    return found
    return None


def image_size(path: Path) -> tuple[int, int]:
    """(width, height) in pixels, from the file's header. Raises CaptureError."""
    try:
        if path.suffix.lower() == ".exr":
            low, high = OpenEXR.File(str(path), header_only=True).header()["displayWindow"]
            return int(high[0] - low[0]) + 1, int(high[1] - low[1]) + 1
        with Image.open(path) as image:
            return image.size
    except (OSError, ValueError, RuntimeError, KeyError) as error:
        raise _unreadable(path, error) from error


@dataclass
class Raster:
    """An image as its file stores it. `rows` makes a few rows linear at a time.

    The whole image as float32 radiance would be four times as large as an 8-bit file in memory. OpenEXR stores colors
    multiplied by alpha; `rows` divides them by alpha.
    """

    stored: np.ndarray
    """[H, W, C] uint8, uint16, float16 or float32; C = 1 (grey), 2 (grey, alpha), 3 (RGB) or 4 (RGBA)"""
    encoded: bool
    """The values are encoded with the sRGB curve."""

    @property
    def size(self) -> tuple[int, int]:
        """(H, W)"""
        return self.stored.shape[0], self.stored.shape[1]

    @property
    def is_float(self) -> bool:
        """Whether the image may hold NaN, infinity, negative values and values above 1."""
        return self.stored.dtype.kind == "f"

    @property
    def _top(self) -> np.float32:
        return np.float32(1 if self.is_float else np.iinfo(self.stored.dtype).max)

    def least_alpha(self) -> float:
        """Smallest alpha in the image, 0..1; 1 where the file has no alpha."""
        if self.stored.shape[-1] in (1, 3):
            return 1.0
        alpha = self.stored[..., -1]
        if self.is_float:
            alpha = np.clip(np.nan_to_num(alpha), 0.0, 1.0)
        return float(np.float32(alpha.min()) / self._top)

    @property
    def has_alpha(self) -> bool:
        """Whether some pixel is not opaque (alpha below 0.999)."""
        return self.least_alpha() < 0.999

    def rows(self, start: int = 0, end: int | None = None) -> tuple[np.ndarray, np.ndarray | None]:
        """Radiance [h, W, 3] linear float32 of the rows start to end - 1, and alpha [h, W] in 0..1, or None without alpha.

        The radiance of an OpenEXR file may hold NaN, infinity and negative values.
        """
        part = self.stored[start:end]
        color = np.repeat(part[..., :1], 3, -1) if part.shape[-1] <= 2 else part[..., :3]
        alpha = part[..., -1].astype(np.float32) / self._top if part.shape[-1] in (2, 4) else None
        if self.is_float:
            color = color.astype(np.float32)
            if alpha is not None:
                with np.errstate(invalid="ignore", divide="ignore"):
                    opaque = alpha[..., None]
                    color = np.where(opaque > 1e-4, color / np.maximum(opaque, 1e-4), color)
                alpha = np.clip(np.nan_to_num(alpha), 0.0, 1.0)
        elif not self.encoded:
            color = color.astype(np.float32) / self._top
        else:
            color = _SRGB_8[color] if part.dtype == np.uint8 else srgb_to_linear(color / float(self._top))
        return color, alpha


def open_image(path: Path, color_space: str) -> Raster:
    """Open an image file; its values stay as stored. Raises CaptureError if it cannot be read as an image."""
    try:
        if path.suffix.lower() == ".exr":
            return Raster(_read_exr(path), False)
        return Raster(_read_integer(path), color_space != "linear")
    except (OSError, ValueError, RuntimeError, SyntaxError, KeyError) as error:
        raise _unreadable(path, error) from error


@dataclass
class MaskRaster:
    """A mask file. The coverage is its alpha, if some of that is below 1; else its first channel, without sRGB decoding."""

    raster: Raster
    from_alpha: bool

    @classmethod
    def of(cls, path: Path) -> MaskRaster:
        """Open the mask file at `path`. Raises CaptureError."""
        raster = open_image(path, "linear")
        return cls(raster, raster.least_alpha() < 1.0)

    @property
    def size(self) -> tuple[int, int]:
        """(H, W)"""
        return self.raster.size

    def rows(self, start: int = 0, end: int | None = None) -> np.ndarray:
        """Coverage [h, W] float32 in 0..1 of the rows start to end - 1."""
        color, alpha = self.raster.rows(start, end)
        coverage = alpha if self.from_alpha and alpha is not None else color[..., 0]
        return np.nan_to_num(np.clip(coverage, 0.0, 1.0)).astype(np.float32)


def _unreadable(path: Path, error: Exception) -> CaptureError:
    return CaptureError(
        f"{path.name} cannot be read as an image ({error})", "Replace the file, or leave it out of transforms.json."
    )


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


def _read_exr(path: Path) -> np.ndarray:
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
        return pixels
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


def _read_integer(path: Path) -> np.ndarray:
    if path.suffix.lower() == ".png" and png16.header(path)[2] == 16 and not png16.header(path)[4]:
        return png16.read_png16(path)
    with Image.open(path) as image:
        alpha = "A" in image.getbands() or "transparency" in image.info
        mode = "RGBA" if alpha else "RGB"
        return np.asarray(image if image.mode == mode else image.convert(mode))
