"""Photos as a phone takes them: a lens with distortion, an automatic exposure, and JPEG files with EXIF data.

Cycles renders without distortion, and with a margin. The photo is then resampled as the lens would have shown it.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..scene_io.srgb import linear_to_srgb
from .files.exif import FILM_FOCAL_LENGTH
from .files.photo_files import BRIGHTNESS, automatic_gain, film_focal_length, write_jpeg


@dataclass(frozen=True)
class Phone:
    """A square camera with the OpenCV distortion k1 and k2."""

    size: int
    """width and height of a photo in pixels"""
    field_of_view: float
    """radians, of a lens without distortion and with the same focal length"""
    k1: float = -0.12
    k2: float = 0.03

    @property
    def focal_length(self) -> float:
        """in pixels"""
        return 0.5 * self.size / math.tan(0.5 * self.field_of_view)

    @property
    def intrinsics(self) -> dict:
        """The keys of `transforms.json` that tell the camera and the encoding of its photos."""
        middle = self.size / 2
        camera = {"camera_model": "OPENCV", "w": self.size, "h": self.size, "cx": middle, "cy": middle}
        return camera | {"k1": self.k1, "k2": self.k2, "color_space": "srgb"}

    @property
    def rendered_size(self) -> int:
        """Width and height of the render that the photo is resampled from. A pixel covers the same angle in both."""
        x, y = self.pinhole_places()
        return 2 * math.ceil(max(np.abs(x).max(), np.abs(y).max()) * self.focal_length + 2)

    @property
    def rendered_field_of_view(self) -> float:
        """radians"""
        return 2 * math.atan(0.5 * self.rendered_size / self.focal_length)

    def pinhole_places(self) -> tuple[np.ndarray, np.ndarray]:
        """Where a lens without distortion would show what each pixel shows: x, y [size, size] for a focal length of 1.

        Found by fixed-point iteration. It converges for lenses whose distortion is below a third.
        """
        place = (np.arange(self.size) + 0.5 - self.size / 2) / self.focal_length
        shown_x, shown_y = np.meshgrid(place, place)
        x, y = shown_x, shown_y
        for _ in range(30):
            r2 = x * x + y * y
            factor = 1 + self.k1 * r2 + self.k2 * r2 * r2
            x, y = shown_x / factor, shown_y / factor
        return x, y

    def resampled(self, image: np.ndarray) -> np.ndarray:
        """The render [R, R, ...] as the lens shows it [size, size, ...]. Values are kept within 0 and the largest one."""
        middle = len(image) / 2
        x, y = (place * self.focal_length + middle - 0.5 for place in self.pinhole_places())
        column, row = np.floor(x).astype(int), np.floor(y).astype(int)
        out = np.zeros((*x.shape, *image.shape[2:]), np.float64)
        for i, down in enumerate(_catmull_rom(y - row)):
            for j, across in enumerate(_catmull_rom(x - column)):
                weight = (down * across).reshape(*x.shape, *[1] * (image.ndim - 2))
                out += weight * image[np.clip(row + i - 1, 0, len(image) - 1), np.clip(column + j - 1, 0, len(image) - 1)]
        return out.clip(0, image.max()).astype(np.float32)

    def take(self, path: Path, radiance: np.ndarray, gain: float) -> None:
        """Write the photo of a resampled render [size, size, 3] as JPEG, with its own exposure around `gain`.

        The file is written under a temporary name and then renamed. Raises OSError where it cannot be written.
        """
        encoded = linear_to_srgb(radiance * automatic_gain(radiance, BRIGHTNESS, gain))
        write_jpeg(path, encoded, {FILM_FOCAL_LENGTH: film_focal_length(self.focal_length, self.size)})


def _catmull_rom(t: np.ndarray) -> list[np.ndarray]:
    """Weights of the four pixels around a place that is t in 0..1 behind the second one."""
    return [
        0.5 * t * (-1 + t * (2 - t)),
        1 + 0.5 * t * t * (3 * t - 5),
        0.5 * t * (1 + t * (4 - 3 * t)),
        0.5 * t * t * (t - 1),
    ]
