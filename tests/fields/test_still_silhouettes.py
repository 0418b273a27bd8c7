"""Silhouettes without masks on a turntable: a ball beside the axis turns before a printed room that stands still."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from scipy import ndimage

from blender_nep.fields.still_silhouettes import LOWEST_SHARE, rows_of, still_silhouettes
from blender_nep.fields.visual_hull import carve, score_cells
from support.turning_ball import BALL, PLACE, SIDE, turning_ball


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """The rays of photos in two rows, and where they show the ball, [N] bool."""
    return turning_ball(tmp_path_factory.mktemp("capture"))


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
