"""Photos of a printed ball on a printed plate, which turn before the still room of `printed_room`: a turntable."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image

from blender_nep.capture.cameras.camera import Camera
from support.captures import look_at
from support.printed_room import FOCAL, HEIGHT, LENS, WIDTH, gray, own_directions, printed

CENTER, BALL, PLATE = np.array([0.1, 0.0, -0.4]), 0.6, 1.2
"""Center and radius of the ball, and radius of the plate at the height -1"""


def camera(degrees: float) -> Camera:
    """The camera in the object's frame, after the table has turned by an angle."""
    around = np.radians(-degrees)
    matrix = look_at(np.array([2.6 * np.cos(around), 2.6 * np.sin(around), 1.0]), np.array([0.0, 0.0, -0.5]))
    return Camera(WIDTH, HEIGHT, FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2, matrix, LENS)


def traced(seen_by: Camera, own: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Gray [n] of the ball and the plate along the camera's own directions [n, 3], and where these are seen [n] bool."""
    origin, direction = seen_by.position, own @ seen_by.camera_to_world[:3, :3].T
    middle = CENTER - origin
    along = direction @ middle
    under = along**2 - middle @ middle + BALL**2
    nearest = np.where(under > 0, along - np.sqrt(np.maximum(under, 0)), np.inf)
    plane = np.where(direction[:, 2] < -1e-6, (-1 - origin[2]) / np.minimum(direction[:, 2], -1e-6), np.inf)
    on_plate = np.linalg.norm(origin[:2] + np.minimum(plane, 99)[:, None] * direction[:, :2], axis=1) < PLATE
    nearest = np.minimum(nearest, np.where(on_plate, plane, np.inf))
    seen = np.isfinite(nearest)
    points = origin + np.where(seen, nearest, 0)[:, None] * direction
    return printed(points, 5), seen


def photograph(degrees: float, samples: int = 2) -> tuple[Image.Image, np.ndarray]:
    """The photo after the table has turned by an angle, and where it shows what turns, [h, w] bool."""
    total, shown = np.zeros((2, WIDTH * HEIGHT))
    still = camera(0)
    for i in range(samples):
        for j in range(samples):
            own = own_directions(FOCAL, (i + 0.5) / samples, (j + 0.5) / samples)
            room = gray(still.position, own @ still.camera_to_world[:3, :3].T, 0)
            thing, seen = traced(camera(degrees), own)
            total += np.where(seen, thing, room)
            shown += seen
    picture = np.round(255 * total.reshape(HEIGHT, WIDTH) / samples**2).astype(np.uint8)
    return Image.fromarray(picture), shown.reshape(HEIGHT, WIDTH) > samples**2 / 2


def write_photos(folder: Path, count: int) -> tuple[list[Camera], list[np.ndarray]]:
    """Write the photos of one turn. Returns their cameras in the object's frame, and where they show what turns."""
    folder.mkdir(parents=True, exist_ok=True)
    cameras, shown = [], []
    for number in range(count):
        degrees = 360 * number / count
        picture, turning = photograph(degrees)
        picture.save(folder / f"photo_{number:02d}.jpg", quality=95)
        cameras.append(camera(degrees))
        shown.append(turning)
    return cameras, shown
