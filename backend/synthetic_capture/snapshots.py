"""Photos as a phone takes them: a lens with distortion, an automatic exposure, and JPEG files with EXIF data.

Cycles renders without distortion, and with a margin. The photo is then resampled as the lens would have shown it.
"""

import math
import os
import struct
import tempfile
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from ..scene_io.image_files import write_whole
from ..scene_io.srgb import linear_to_srgb
from .photo_files import automatic_gain

BRIGHTNESS = 0.36
"""Mean sRGB value of the photos that the exposure aims at."""
QUALITY = 93
"""of the JPEG files"""
FILM_DIAGONAL = 43.2666
"""mm; EXIF tells the focal length for film of this diagonal"""


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
        data = jpeg(linear_to_srgb(radiance * automatic_gain(radiance, BRIGHTNESS, gain)))
        film = FILM_DIAGONAL * self.focal_length / (self.size * math.sqrt(2))
        write_whole(path, data[:2] + exif(film) + data[2:])


def _catmull_rom(t: np.ndarray) -> list[np.ndarray]:
    """Weights of the four pixels around a place that is t in 0..1 behind the second one."""
    return [
        0.5 * t * (-1 + t * (2 - t)),
        1 + 0.5 * t * t * (3 * t - 5),
        0.5 * t * (1 + t * (4 - 3 * t)),
        0.5 * t * t * (t - 1),
    ]


def jpeg(encoded: np.ndarray) -> bytes:
    """The JPEG file of sRGB-encoded values [H, W, 3] in 0..1. Raises OSError where Blender cannot write it."""
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


def exif(focal_length: float) -> bytes:
    """The JPEG segment with EXIF data that say one thing: the focal length [mm] for film of 36 x 24 mm."""
    entry = struct.pack("<HHIHH", 0xA405, 3, 1, round(focal_length), 0)
    pointer = struct.pack("<HHII", 0x8769, 4, 1, 26)
    tiff = struct.pack("<2sHI", b"II", 42, 8) + struct.pack("<H", 1) + pointer + struct.pack("<I", 0)
    body = b"Exif\0\0" + tiff + struct.pack("<H", 1) + entry + struct.pack("<I", 0)
    return b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body
