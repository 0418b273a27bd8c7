"""Writes the photos of a synthetic capture in the formats that cameras give, with an exposure."""

import math
from pathlib import Path

import numpy as np

from ..scene_io.image_files import write_half_exr, write_png
from ..scene_io.srgb import linear_to_srgb

ENDINGS = {"EXR half linear": ".exr", "PNG 8 bits sRGB": ".png", "PNG 16 bits sRGB": ".png"}
"""Name of a format -> the ending of its files."""
AUTO_SHARE, AUTO_LIMIT = 0.5, 0.5
"""An automatic exposure makes up for this share of a photo's difference in brightness, by at most so many stops."""


def write_photo(path: Path, radiance: np.ndarray, photo_format: str) -> None:
    """Write linear radiance [H,W,3] in one of the formats ENDINGS. The formats other than EXR clip radiance above 1."""
    if photo_format == "EXR half linear":
        write_half_exr(path, radiance)
        return
    kind = np.uint8 if "8 bits" in photo_format else np.uint16
    write_png(path, np.round(linear_to_srgb(radiance) * np.iinfo(kind).max).astype(kind))


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
