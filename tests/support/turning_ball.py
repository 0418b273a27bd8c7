"""Photos of a printed ball beside the axis of a turntable before a still printed room, with or without a plate."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from blender_nep.capture import PixelRays, load_capture
from blender_nep.capture.turntable.motions import in_unit_frame, on_turntable
from support.captures import look_at, write_exr
from support.printed_room import printed
from support.table_scene import pattern

SIDE, FOCAL, ROOM = 64, 70.0, 6.0
PLACE, BALL = np.array([0.3, 0.1, -0.1]), 0.45
"""Center of the ball in the object's frame, and its radius"""
HEIGHT, PLATE = -0.55, 0.85
"""Height of the plate, which the ball touches, and its radius"""
ROWS = ((1.0, range(0, 360, 24)), (2.2, range(0, 360, 30)))
"""The heights of the camera, and the angles by which the table had turned, in degrees"""


def photo(still: np.ndarray, turn: np.ndarray, plate: str | None) -> tuple[np.ndarray, np.ndarray]:
    """The photo [n, 3] of the ball that has turned by turn [3, 3], and where it shows the ball [n]; camera still [4, 4].

    plate: "printed", "plain" or None.
    """
    row, column = np.mgrid[:SIDE, :SIDE].reshape(2, -1) + 0.5
    local = np.stack([(column - SIDE / 2) / FOCAL, (SIDE / 2 - row) / FOCAL, -np.ones_like(row)], -1)
    direction = local / np.linalg.norm(local, axis=1, keepdims=True) @ still[:3, :3].T
    origin, center = still[:3, 3], turn @ PLACE
    along = direction @ origin
    wall = origin + (-along + np.sqrt(along**2 - origin @ origin + ROOM**2))[:, None] * direction
    color = printed(wall / 3, 0)[:, None] * [0.5, 0.45, 0.4]
    if plate is not None:
        point = origin + ((HEIGHT - origin[2]) / np.minimum(direction[:, 2], -1e-6))[:, None] * direction
        on_plate = (direction[:, 2] < 0) & (np.hypot(point[:, 0], point[:, 1]) < PLATE)
        color[on_plate] = pattern(point[on_plate] @ turn) if plate == "printed" else [0.35, 0.3, 0.4]
    to = origin - center
    along = direction @ to
    under = along**2 - to @ to + BALL**2
    hit = under > 0
    point = to + (-along - np.sqrt(np.maximum(under, 0)))[:, None] * direction
    color[hit] = printed(point[hit] @ turn, 1)[:, None] * [0.3, 0.5, 0.6]
    return color * (1 + 0.01 * np.random.default_rng(int(1e6 * abs(turn[0, 0]))).normal(size=color.shape)), hit


def turning_ball(folder: Path, plate: str | None = None) -> tuple[PixelRays, np.ndarray]:
    """Write the photos in two rows. Returns their rays, with the motions, and where they show the ball, [N] bool."""
    frames, shown = [], []
    for height, angles in ROWS:
        still = look_at(np.array([3.0, 0.0, height]), np.zeros(3))
        for angle in np.radians(angles):
            turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
            color, hit = photo(still, turn, plate)
            pose = np.eye(4)
            pose[:3, :3], pose[:3, 3] = turn.T @ still[:3, :3], turn.T @ still[:3, 3]
            name = f"{len(frames):02d}.exr"
            write_exr(folder / name, color.reshape(SIDE, SIDE, 3).astype(np.float32))
            frames.append({"file_path": name, "transform_matrix": pose.tolist()})
            shown.append(hit)
    meta = {"w": SIDE, "h": SIDE, "fl_x": FOCAL, "turntable": True, "object_center": [0, 0, 0], "object_radius": 1}
    (folder / "transforms.json").write_text(json.dumps(meta | {"frames": frames}))
    capture = on_turntable(load_capture(folder)).capture
    rays = PixelRays.from_capture(capture, 10**6, use_masks=False)
    return rays.with_turntable(in_unit_frame(capture, capture.views[0])), np.concatenate(shown)
