"""Photos of printed things, traced analytically through a lens with distortion, as structure from motion needs them."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
from PIL import Image

from blender_nep.capture.cameras.camera import Camera
from blender_nep.capture.cameras.lens import Lens
from support.captures import look_at

WIDTH, HEIGHT, FOCAL = 320, 240, 300.0
LENS = Lens(k1=-0.1, k2=0.02)
CELLS = (3.0, 11.0)
"""Cells of the print for each unit of length"""
BALLS = (((0.0, 0.0, -0.4), 0.6), ((1.3, 0.4, -0.6), 0.4), ((-0.9, 1.0, -0.65), 0.35), ((-0.5, -1.3, -0.7), 0.3))
"""Center and radius"""


def printed(points: np.ndarray, seed: int) -> np.ndarray:
    """Gray [n] of a print whose cells repeat nowhere: a hash of the cell, for each of CELLS."""
    gray = np.zeros(len(points))
    for scale in CELLS:
        cell = np.floor(points * scale + 0.31).astype(np.int64)
        mixed = (cell * [73856093, 19349663, 83492791]).sum(1) ^ (seed * 2654435761)
        mixed = (mixed ^ (mixed >> 13)) * 1274126177
        gray += ((mixed ^ (mixed >> 16)) & 255) / 255
    return 0.1 + 0.8 * gray / len(CELLS)


def gray(origin: np.ndarray, directions: np.ndarray, seed: int) -> np.ndarray:
    """What rays from `origin` [3] along unit directions [n, 3] see: balls, the floor at -1, or a gray sky."""
    nearest = np.where(directions[:, 2] < -1e-6, (-1 - origin[2]) / np.minimum(directions[:, 2], -1e-6), np.inf)
    for center, radius in BALLS:
        middle = np.array(center) - origin
        along = directions @ middle
        under = along**2 - middle @ middle + radius**2
        hit = along - np.sqrt(np.maximum(under, 0))
        nearest = np.where((under > 0) & (hit > 0), np.minimum(nearest, hit), nearest)
    met = nearest < 30
    out = np.full(len(directions), 0.5)
    out[met] = printed(origin + nearest[met, None] * directions[met], seed)
    return out


def camera(number: int, count: int) -> Camera:
    """The number-th of `count` cameras on a ring whose height varies."""
    around, up = 2 * np.pi * number / count, 0.45 + 0.2 * (number % 3)
    position = 3.0 * np.array([np.cos(around) * np.cos(up), np.sin(around) * np.cos(up), np.sin(up)]) + [0, 0, -0.4]
    matrix = look_at(position, np.array([0.0, 0.0, -0.4]))
    return Camera(WIDTH, HEIGHT, FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2, matrix, LENS)


@functools.lru_cache(maxsize=32)
def own_directions(focal: float, row_shift: float, column_shift: float) -> np.ndarray:
    """Unit directions [n, 3] in a camera's own axes, for all pixels. To undo the distortion takes most of a photo's time."""
    row, column = np.mgrid[:HEIGHT, :WIDTH].reshape(2, -1) + np.array([[row_shift], [column_shift]])
    return Camera(WIDTH, HEIGHT, focal, focal, WIDTH / 2, HEIGHT / 2, np.eye(4), LENS).directions(column, row)


def photograph(seen_by: Camera, seed: int = 0, samples: int = 3) -> Image.Image:
    """The photo of a camera of this size and lens, of any focal length; samples x samples rays in each pixel."""
    total = np.zeros(WIDTH * HEIGHT)
    for i in range(samples):
        for j in range(samples):
            own = own_directions(seen_by.fl_x, (i + 0.5) / samples, (j + 0.5) / samples)
            total += gray(seen_by.position, own @ seen_by.camera_to_world[:3, :3].T, seed)
    return Image.fromarray(np.round(255 * total.reshape(HEIGHT, WIDTH) / samples**2).astype(np.uint8))


def write_photos(folder: Path, count: int = 16) -> list[Camera]:
    """Write the photos photo_00.jpg and so on, and return their cameras."""
    folder.mkdir(parents=True, exist_ok=True)
    cameras = [camera(number, count) for number in range(count)]
    for number, seen_by in enumerate(cameras):
        photograph(seen_by).save(folder / f"photo_{number:02d}.jpg", quality=95)
    return cameras
