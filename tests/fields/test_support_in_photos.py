"""The plane under an object is found in the photos, at its height and tilt; where there is none, none is found."""

import numpy as np
import pytest
import torch

from blender_nep.capture import PixelRays, load_capture
from blender_nep.support import in_photos
from blender_nep.support.foot import FOOT, with_closed_foot
from blender_nep.support.in_photos import support_in_photos
from blender_nep.support.plane import Support
from support.table_scene import HEIGHT, turn, write_table_scene


def rays_of(folder):
    return PixelRays.from_capture(load_capture(folder), 10_000, False, torch.device("cpu"))


@pytest.mark.parametrize("tilt", [0.0, 0.5])
def test_a_patterned_table_is_found_at_its_height_and_tilt(tmp_path, tilt):
    support = support_in_photos(rays_of(write_table_scene(tmp_path / "capture", tilt=tilt)))
    assert support is not None
    assert support.height == pytest.approx(HEIGHT, abs=0.01)
    assert support.normal @ (turn(tilt) @ [0, 0, 1]) > np.cos(np.radians(1))


@pytest.mark.slow
def test_a_glossy_table_is_found_by_its_pattern(tmp_path, monkeypatch):
    rays = rays_of(write_table_scene(tmp_path / "capture", glossy=True))
    support = support_in_photos(rays)
    assert support is not None and support.height == pytest.approx(HEIGHT, abs=0.01)
    monkeypatch.setattr(in_photos, "plane_by_details", lambda photos, planes: None)
    assert support_in_photos(rays) is None, "its colors change too much from photo to photo"


def test_a_small_plate_is_found_at_its_height_and_tilt(tmp_path):
    """Its rim is 0.25 radii outside the object's sphere. What lies behind must not draw the plane away."""
    support = support_in_photos(rays_of(write_table_scene(tmp_path / "capture", radius=1.05)))
    assert support is not None and support.height == pytest.approx(HEIGHT, abs=0.01)
    assert support.normal @ [0, 0, 1] > np.cos(np.radians(0.3))


def test_a_patterned_plate_in_the_sphere_is_found_at_its_height(tmp_path):
    support = support_in_photos(rays_of(write_table_scene(tmp_path / "capture", radius=0.7)))
    assert support is not None and support.height == pytest.approx(HEIGHT, abs=0.015)


@pytest.mark.parametrize(
    "scene",
    [{"radius": 0.0}, {"elevations": (-40, 15, 35, 60)}, {"plain": True}],
    ids=["no table", "a table that some photos are taken from below", "a plain table"],
)
def test_nothing_is_found_where_the_photos_show_no_support(tmp_path, scene):
    assert support_in_photos(rays_of(write_table_scene(tmp_path / "capture", **scene))) is None


def test_the_hull_of_an_object_on_a_plane_gets_a_closed_foot():
    n, support = 48, Support(np.array([0.0, 0.0, 1.0]), -0.5)
    axis = (np.arange(n) + 0.5) / n * 2 - 1
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    cylinder = np.maximum(np.hypot(x, y) - 0.4, z - 0.3)
    hollow = np.maximum(cylinder, -0.45 - z)  # the lowest twentieth of the object is missing
    closed = with_closed_foot(hollow.astype(np.float32), support)
    lost = (closed >= 0) & (cylinder < 0) & (z > -0.5) & (np.hypot(x, y) < 0.37 - FOOT)
    assert not lost.any()
    assert not ((closed < 0) & (cylinder > 0.02)).any(), "nothing grows beside the object"
