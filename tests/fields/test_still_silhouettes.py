"""Silhouettes without masks on a turntable: a ball beside the axis turns before a printed room that stands still."""

from __future__ import annotations

import json

import numpy as np
import pytest
import torch
from scipy import ndimage

from blender_nep.capture import PixelRays, load_capture
from blender_nep.capture.turntable.motions import in_unit_frame, on_turntable
from blender_nep.fields.still_silhouettes import LOWEST_SHARE, rows_of, still_silhouettes
from blender_nep.fields.visual_hull import carve, score_cells
from support.captures import look_at, write_exr
from support.printed_room import printed

SIDE, FOCAL, ROOM = 64, 70.0, 6.0
PLACE, BALL = np.array([0.3, 0.1, -0.1]), 0.45
"""Center of the ball in the object's frame, and its radius"""


def photo(still: np.ndarray, turn: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The photo [n, 3] of the ball that has turned by turn [3, 3], and where it shows the ball [n]; camera still [4, 4]."""
    row, column = np.mgrid[:SIDE, :SIDE].reshape(2, -1) + 0.5
    local = np.stack([(column - SIDE / 2) / FOCAL, (SIDE / 2 - row) / FOCAL, -np.ones_like(row)], -1)
    direction = local / np.linalg.norm(local, axis=1, keepdims=True) @ still[:3, :3].T
    origin, center = still[:3, 3], turn @ PLACE
    along = direction @ origin
    wall = origin + (-along + np.sqrt(along**2 - origin @ origin + ROOM**2))[:, None] * direction
    color = printed(wall / 3, 0)[:, None] * [0.5, 0.45, 0.4]
    to = origin - center
    along = direction @ to
    under = along**2 - to @ to + BALL**2
    hit = under > 0
    point = to + (-along - np.sqrt(np.maximum(under, 0)))[:, None] * direction
    color[hit] = printed(point[hit] @ turn, 1)[:, None] * [0.3, 0.5, 0.6]
    return color * (1 + 0.01 * np.random.default_rng(int(1e6 * abs(turn[0, 0]))).normal(size=color.shape)), hit


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """The rays of photos in two rows, and where they show the ball, [N] bool."""
    folder = tmp_path_factory.mktemp("capture")
    frames, shown = [], []
    for height, angles in ((1.0, range(0, 360, 24)), (2.2, range(0, 360, 30))):
        still = look_at(np.array([3.0, 0.0, height]), np.zeros(3))
        for angle in np.radians(angles):
            turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
            color, hit = photo(still, turn)
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


def test_rows_are_told_by_the_camera_in_the_room(scene):
    assert rows_of(scene[0]) == [list(range(15)), list(range(15, 27))]


def test_what_turns_is_told_from_what_stands_still(scene):
    rays, shown = scene
    found = torch.cat([values.flatten() for values in still_silhouettes(rays)]).numpy() >= 0.5
    assert (found & shown).sum() / shown.sum() > 0.97
    rim = np.stack([ndimage.binary_dilation(part, iterations=4) for part in shown.reshape(-1, SIDE, SIDE)]).ravel()
    assert (found & ~rim).sum() < 0.01 * shown.sum() and (found & ~shown).sum() < 0.15 * shown.sum()


def test_the_silhouettes_carve_the_ball(scene):
    rays, _ = scene
    hull = carve(score_cells(rays, still_silhouettes(rays), 48, LOWEST_SHARE))
    axis = (np.arange(48) + 0.5) / 24 - 1
    inside = np.linalg.norm(np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1) - PLACE, axis=-1) < BALL
    both = ((hull.sdf < 0) & inside).sum() / ((hull.sdf < 0) | inside).sum()
    assert both > 0.8 and hull.contrast > 3


def test_a_photo_alone_at_its_place_does_not_vote(scene):
    rays, _ = scene
    motions = rays.turntable
    offset = motions.offset.clone()
    offset[3] += 0.1
    moved = rays.with_turntable(type(motions)(motions.rotation, offset))
    assert len(rows_of(moved)) == 3
    maps = still_silhouettes(moved)
    assert maps[3].isnan().all() and not any(values.isnan().any() for k, values in enumerate(maps) if k != 3)


def test_rays_without_motions_have_no_rows(scene):
    with pytest.raises(ValueError, match="turntable"):
        still_silhouettes(scene[0].with_turntable(None))
