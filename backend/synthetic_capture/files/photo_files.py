"""Writes the photos of a synthetic capture in the formats that cameras give, with an exposure."""

import math
import os
import tempfile
from fractions import Fraction
from pathlib import Path

import bpy
import numpy as np

from ...scene_io.image_files import write_half_exr, write_png, write_whole
from ...scene_io.srgb import linear_to_srgb
from .exif import exif

ENDINGS = {"EXR half linear": ".exr", "PNG 8 bits sRGB": ".png", "PNG 16 bits sRGB": ".png"}
"""Name of a format -> the ending of its files."""
BRIGHTNESS = 0.36
"""Mean sRGB value of JPEG photos that the exposure aims at."""
QUALITY = 93
"""of the JPEG files"""
FILM_DIAGONAL = 43.2666
"""mm; EXIF tells the focal length for film of this diagonal"""
AUTO_SHARE, AUTO_LIMIT = 0.5, 0.5
"""An automatic exposure makes up for this share of a photo's difference in brightness, by at most so many stops."""


def write_photo(path: Path, radiance: np.ndarray, photo_format: str) -> None:
    """Write linear radiance [H,W,3] in one of the formats ENDINGS. The formats other than EXR clip radiance above 1."""
    if photo_format == "EXR half linear":
        write_half_exr(path, radiance)
        return
    kind = np.uint8 if "8 bits" in photo_format else np.uint16
    write_png(path, np.round(linear_to_srgb(radiance) * np.iinfo(kind).max).astype(kind))


def write_jpeg(path: Path, encoded: np.ndarray, tags: dict[int, int | Fraction | str]) -> None:
    """Write sRGB-encoded values [H,W,3] in 0..1 as a JPEG file with these EXIF tags (see `exif`).

    The file is written under a temporary name and then renamed. Raises OSError where it cannot be written.
    """
    data = _jpeg(encoded)
    write_whole(path, data[:2] + exif(tags) + data[2:])


def _jpeg(encoded: np.ndarray) -> bytes:
    """The JPEG file of sRGB-encoded values [H,W,3]. Raises OSError where Blender cannot write it."""
    height, width = encoded.shape[:2]
    image = bpy.data.images.new("photo", width, height, alpha=False)
    try:
        pixels = np.ones((height, width, 4), np.float32)
        pixels[..., :3] = encoded[::-1]
        image.pixels.foreach_set(pixels.ravel())
        image.file_format = "JPEG"
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "photo.jpg"
            image.save(filepath=os.fspath(path), quality=QUALITY)
            return path.read_bytes()
    except RuntimeError as error:
        raise OSError(f"Blender cannot write a photo: {error}") from error
    finally:
        bpy.data.images.remove(image)


def film_focal_length(focal_length: float, size: int) -> int:
    """The focal length [mm] that EXIF tells for film, of a square photo of `size` pixels with this one in pixels."""
    return round(FILM_DIAGONAL * focal_length / (size * math.sqrt(2)))


def gain_for(photos: list[np.ndarray], brightness: float) -> float:
    """The factor that gives linear photos [H,W,3] the mean sRGB value `brightness` (0..1), pixels above white clipped."""
    low, high = -20.0, 20.0  # stops
    for _ in range(40):
        middle = (low + high) / 2
        mean = np.mean([linear_to_srgb(photo * 2**middle).mean() for photo in photos])
        low, high = (middle, high) if mean < brightness else (low, middle)
    return 2 ** ((low + high) / 2)


def automatic_gain(photo: np.ndarray, brightness: float, base: float) -> float:
    """The gain of one photo [H,W,3] that a camera with automatic exposure takes. `base` is the gain of all photos."""
    stops = AUTO_SHARE * math.log2(gain_for([photo], brightness) / base)
    return base * 2 ** min(max(stops, -AUTO_LIMIT), AUTO_LIMIT)
