"""Photos on disk as linear radiance: OpenEXR (linear), PNG and JPEG (sRGB, 8 or 16 bits)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import OpenEXR
from PIL import Image

from blender_nep.capture import png16
from blender_nep.errors import CaptureError

SUFFIXES = (".exr", ".png", ".jpg", ".jpeg")


def srgb_to_linear(x: np.ndarray) -> np.ndarray:
    """sRGB-encoded values in [0, 1] to linear (IEC 61966-2-1)."""
    return np.where(x <= 0.04045, x / 12.92, ((np.maximum(x, 0.04045) + 0.055) / 1.055) ** 2.4).astype(np.float32)


def linear_to_srgb(x: np.ndarray) -> np.ndarray:
    """Linear values to sRGB-encoded ones, both clipped to [0, 1] (IEC 61966-2-1)."""
    x = np.clip(x, 0.0, 1.0)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 0.0031308) ** (1 / 2.4) - 0.055).astype(np.float32)


_SRGB_8 = srgb_to_linear(np.arange(256) / 255.0)


def find_image(folder: Path, name: str) -> Path | None:
    """The file `name` in `folder`; where its extension is missing (as in Blender datasets), the first that fits."""
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


def read_image(path: Path, color_space: str) -> tuple[np.ndarray, np.ndarray | None]:
    """Radiance [H, W, 3] linear float32 (raw: an EXR may hold NaN, Inf, negatives) and alpha [H, W] in 0..1 or None.

    Radiance is not multiplied by alpha: OpenEXR's associated alpha is divided out.
    """
    try:
        if path.suffix.lower() == ".exr":
            return _read_exr(path)
        return _read_integer(path, color_space)
    except (OSError, ValueError, RuntimeError, SyntaxError, KeyError) as error:
        raise _unreadable(path, error) from error


def read_mask(path: Path) -> np.ndarray:
    """Coverage [H, W] float32 in 0..1: alpha where the file has it and it varies, else the first channel, undecoded."""
    color, alpha = read_image(path, "linear")
    coverage = alpha if alpha is not None and alpha.min() < 1.0 else color[..., 0]
    return np.nan_to_num(np.clip(coverage, 0.0, 1.0)).astype(np.float32)


def _unreadable(path: Path, error: Exception) -> CaptureError:
    return CaptureError(
        f"{path.name} cannot be read as an image ({error})", "Replace the file, or leave it out of transforms.json."
    )


def _color_channels(names: list[str]) -> list[str] | None:
    """The names of R, G, B (or one luminance) in an EXR part: unlayered first, then 'Combined', then any layer."""
    layers = sorted({n.rpartition(".")[0] for n in names}, key=lambda n: (n != "", "combined" not in n.lower(), n))
    for layer in layers:
        prefix = layer + "." if layer else ""
        short = {n[len(prefix) :].upper(): n for n in names if n.rpartition(".")[0] == layer}
        for wanted in ("RGB", "Y"):
            if all(c in short for c in wanted):
                return [short[c] for c in wanted] + ([short["A"]] if "A" in short else [])
    return None


def _read_exr(path: Path) -> tuple[np.ndarray, np.ndarray | None]:
    for part in OpenEXR.File(str(path), separate_channels=True).parts:
        channels = {n: np.asarray(c.pixels, np.float32) for n, c in part.channels.items()}
        names = _color_channels(list(channels))
        if names is None:
            continue
        pixels = np.stack([channels[n] for n in names], -1)
        low, high = part.header["dataWindow"]
        frame_low, frame_high = part.header["displayWindow"]
        if tuple(low) != tuple(frame_low) or tuple(high) != tuple(frame_high):
            pixels = _place(pixels, np.asarray(low) - frame_low, np.asarray(frame_high) - frame_low + 1)
        color = np.repeat(pixels[..., :1], 3, -1) if len(names) <= 2 else pixels[..., :3]
        if len(names) in (1, 3):
            return np.ascontiguousarray(color), None
        alpha = pixels[..., -1]
        with np.errstate(invalid="ignore", divide="ignore"):
            color = np.where(alpha[..., None] > 1e-4, color / np.maximum(alpha, 1e-4)[..., None], color)
        return color.astype(np.float32), np.clip(np.nan_to_num(alpha), 0.0, 1.0)
    raise ValueError("no R, G, B or Y channels")


def _place(pixels: np.ndarray, corner: np.ndarray, size: np.ndarray) -> np.ndarray:
    """An EXR's data window within its display window; what was not stored is NaN."""
    out = np.full((int(size[1]), int(size[0]), pixels.shape[-1]), np.nan, np.float32)
    y, x = np.arange(pixels.shape[0]) + int(corner[1]), np.arange(pixels.shape[1]) + int(corner[0])
    rows, columns = (y >= 0) & (y < out.shape[0]), (x >= 0) & (x < out.shape[1])
    out[np.ix_(y[rows], x[columns])] = pixels[np.ix_(rows, columns)]
    return out


def _read_integer(path: Path, color_space: str) -> tuple[np.ndarray, np.ndarray | None]:
    if path.suffix.lower() == ".png" and png16.header(path)[2] == 16 and not png16.header(path)[4]:
        pixels = png16.read_png16(path)
    else:
        with Image.open(path) as image:
            alpha = "A" in image.getbands() or "transparency" in image.info
            pixels = np.asarray(image.convert("RGBA" if alpha else "RGB"))
    top = float(np.iinfo(pixels.dtype).max)
    color = np.repeat(pixels[..., :1], 3, -1) if pixels.shape[-1] <= 2 else pixels[..., :3]
    if color_space == "linear":
        color = color.astype(np.float32) / np.float32(top)
    elif pixels.dtype == np.uint8:
        color = _SRGB_8[color]
    else:
        color = srgb_to_linear(color / top)
    alpha = pixels[..., -1].astype(np.float32) / np.float32(top) if pixels.shape[-1] in (2, 4) else None
    return color, alpha
