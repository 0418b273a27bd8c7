"""The plane of a plain table is found by the shadow around the foot; where there is no table, none is found."""

import numpy as np
import pytest
import torch

from blender_nep.capture import PixelRays, load_capture
from blender_nep.support import at_foot
from blender_nep.support.at_foot import support_at_foot
from support.table_scene import BALL, CENTER, HEIGHT, turn, write_table_scene


def rays_of(folder):
    return PixelRays.from_capture(load_capture(folder), 10_000, False, torch.device("cpu"))


def ball(tilt: float = 0.0, radius: float = BALL) -> np.ndarray:
    """The SDF of the scene's ball in 64^3 cells, turned with the scene."""
    axis = (np.arange(64) + 0.5) / 64 * 2 - 1
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1)
    return np.linalg.norm(points - turn(tilt) @ CENTER, axis=-1) - radius


@pytest.mark.parametrize("tilt", [0.0, 0.5])
@pytest.mark.parametrize("plain", [True, False])
def test_a_table_is_found_at_its_height_plain_or_not(tmp_path, plain, tilt):
    support = support_at_foot(rays_of(write_table_scene(tmp_path / "capture", plain=plain, tilt=tilt)), ball(tilt))
    assert support is not None
    assert support.height == pytest.approx(HEIGHT, abs=0.04)
    assert support.normal @ (turn(tilt) @ [0, 0, 1]) > np.cos(np.radians(1))


def test_a_hull_that_is_a_little_too_large_does_not_matter(tmp_path):
    support = support_at_foot(rays_of(write_table_scene(tmp_path / "capture", plain=True)), ball(radius=BALL + 0.05))
    assert support is not None and support.height == pytest.approx(HEIGHT, abs=0.04)


@pytest.mark.parametrize(
    "scene",
    [
        {"radius": 0.0},
        {"radius": 0.0, "backdrop": 0.0},
        {"radius": 0.0, "backdrop": 1.0},
        {"plain": True, "elevations": (-40, 15, 35, 60)},
    ],
    ids=["no table", "an even black backdrop", "an even white backdrop", "a table that some photos are taken from below"],
)
def test_nothing_is_found_where_nothing_can_support_the_object(tmp_path, scene):
    assert support_at_foot(rays_of(write_table_scene(tmp_path / "capture", **scene)), ball()) is None


def test_nothing_is_found_without_an_object(tmp_path):
    assert support_at_foot(rays_of(write_table_scene(tmp_path / "capture", plain=True)), np.ones((16, 16, 16))) is None


def test_a_lowest_plane_that_agrees_more_does_not_hide_a_table(tmp_path, monkeypatch):
    """Few points of the lowest plane are seen, so its spread may be small by chance."""

    def spread(near_foot, height):
        return 0.008 if height < -0.97 else 0.012 * (1 + 15 * max(0.0, height - HEIGHT))

    monkeypatch.setattr(at_foot._NearFoot, "spread", spread)
    support = support_at_foot(rays_of(write_table_scene(tmp_path / "capture", plain=True)), ball())
    assert support is not None and support.height == pytest.approx(HEIGHT, abs=0.04)
