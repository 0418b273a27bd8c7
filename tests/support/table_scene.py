"""A capture of a ball on a table, rendered analytically. The table has a pattern, or only the soft shadow of the ball."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from support.captures import camera_ring, write_exr

HEIGHT, BALL = -0.6, 0.45
"""Height of the table, and radius of the ball that touches it"""
CENTER = np.array([0.1, 0.0, HEIGHT + BALL])
SIZE, FOCAL = 72, 90.0


def pattern(points: np.ndarray) -> np.ndarray:
    """Linear radiance [n, 3] of points [n, 3] of the table."""
    x, y = points[:, 0], points[:, 1]
    return np.stack([0.4 + 0.25 * np.sin(5 * x), 0.4 + 0.25 * np.cos(6 * y), 0.3 + 0.2 * np.sin(4 * (x + y))], 1)


def shadow(points: np.ndarray) -> np.ndarray:
    """Linear radiance [n, 3] of points [n, 3] of a plain table, which is darker near the foot of the ball."""
    away = np.linalg.norm(points[:, :2] - CENTER[:2], axis=1)
    return np.array([0.2, 0.3, 0.35]) * (1 - 0.8 * np.exp(-((away / 0.4) ** 2)))[:, None]


def glossy_checkers(points: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Linear radiance [n, 3] of points [n, 3] of a checkered table that mirrors soft lights; directions [n, 3] see it."""
    even = (np.floor(points[:, :1] / 0.3) + np.floor(points[:, 1:2] / 0.3)) % 2
    lamps = np.array([[0.8, 0.0, 0.6], [-0.5, 0.6, 0.62], [-0.4, -0.7, 0.59]])
    lights = np.exp(6 * (directions * [1, 1, -1] @ lamps.T - 1)).sum(1)
    return np.where(even == 1, [0.1, 0.2, 0.18], [0.2, 0.1, 0.16]) + lights[:, None] * [1.0, 0.9, 0.7]


def turn(tilt: float) -> np.ndarray:
    """A rotation [3, 3] about the y axis by `tilt` radians."""
    c, s = np.cos(tilt), np.sin(tilt)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


def colors(
    origin: np.ndarray, directions: np.ndarray, radius: float, plain: bool, glossy: bool, backdrop: float | None
) -> np.ndarray:
    """What rays from `origin` [3] along directions [n, 3] see: the ball, the round table, or walls far away.

    backdrop: the walls' radiance, if they are even.
    """
    color = 0.3 + 0.2 * np.sin(3 * directions) if backdrop is None else np.full(directions.shape, backdrop)
    points = origin + ((HEIGHT - origin[2]) / np.minimum(directions[:, 2], -1e-6))[:, None] * directions
    met = (directions[:, 2] < 0) & (np.hypot(points[:, 0], points[:, 1]) < radius)
    color[met] = glossy_checkers(points[met], directions[met]) if glossy else (shadow if plain else pattern)(points[met])
    along = directions @ (CENTER - origin)
    away = np.linalg.norm(origin + along[:, None] * directions - CENTER, axis=1)
    color[away < BALL] = [0.1, 0.5, 0.2]
    return color


def write_table_scene(
    folder: Path,
    *,
    radius: float = np.inf,
    plain: bool = False,
    glossy: bool = False,
    backdrop: float | None = None,
    tilt: float = 0.0,
    elevations: tuple[float, ...] = (15, 35, 60),
    photos: int = 24,
) -> Path:
    """Write the capture, turned by `tilt` radians with cameras and all. Returns its folder.

    radius: that of the table, in object radii; 0 for none. elevations: those of the rings of cameras, in degrees.
    photos: how many, on all rings together. backdrop: the radiance of even walls.
    """
    (folder / "images").mkdir(parents=True)
    frames = []
    for k, (position, matrix, directions) in enumerate(camera_ring(photos, elevations, SIZE, FOCAL)):
        photo = colors(position, directions, radius, plain, glossy, backdrop)
        write_exr(folder / "images" / f"{k}.exr", photo.reshape(SIZE, SIZE, 3))
        matrix[:3] = turn(tilt) @ matrix[:3]
        frames.append({"file_path": f"images/{k}.exr", "transform_matrix": matrix.tolist()})
    intrinsics = {"w": SIZE, "h": SIZE, "fl_x": FOCAL, "fl_y": FOCAL, "cx": SIZE / 2, "cy": SIZE / 2}
    meta = {
        "camera_model": "PINHOLE",
        **intrinsics,
        "color_space": "linear",
        "object_center": [0, 0, 0],
        "object_radius": 1.0,
    }
    (folder / "transforms.json").write_text(json.dumps({**meta, "frames": frames}))
    return folder
