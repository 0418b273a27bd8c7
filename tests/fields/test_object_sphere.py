"""The object's sphere is found by a quick hull: a ball before walls, in a sphere that is twice too large."""

from dataclasses import replace

import numpy as np
import pytest

from blender_nep.cameras import object_sphere
from blender_nep.cameras.object_sphere import find_object_sphere
from blender_nep.capture import load_capture
from blender_nep.capture.rays.pixel_rays import PixelRays
from blender_nep.presets import preset
from support.table_scene import BALL, CENTER, write_table_scene


@pytest.fixture
def ball(tmp_path, monkeypatch):
    """The capture. A search in it learns from a quarter of the rays, which the hull of a ball does not need."""
    whole = preset("preview")
    few_rays = replace(whole, environment=replace(whole.environment, rays_per_step=whole.environment.rays_per_step // 4))
    monkeypatch.setattr(object_sphere, "preset", {"preview": few_rays}.__getitem__)
    return load_capture(write_table_scene(tmp_path / "ball", radius=0, photos=16))


@pytest.mark.slow
def test_the_sphere_shrinks_around_the_ball_in_any_units(ball, monkeypatch):
    rounds, one_round = [], object_sphere._hull_sphere
    monkeypatch.setattr(object_sphere, "_hull_sphere", lambda *given: rounds.append(one_round(*given)) or rounds[-1])
    here = find_object_sphere(ball)
    away = np.linalg.norm(here.center - CENTER)
    assert here.sure and len(rounds) == 2, "the hull of the first round is coarse"
    assert away + BALL < here.radius < 1.5 * BALL, "the whole ball is in the sphere, and not much else"
    shift, scale = np.array([500.0, -20.0, 7.0]), 1000.0
    views = []
    for view in ball.views:
        matrix = view.camera.camera_to_world.copy()
        matrix[:3, 3] = scale * matrix[:3, 3] + shift
        views.append(replace(view, camera=replace(view.camera, camera_to_world=matrix)))
    monkeypatch.setattr(object_sphere, "_ROUNDS", 1)
    far = find_object_sphere(replace(ball, views=views, object_center=shift, object_radius=scale))
    first = rounds[0]  # in the capture's own units, which are those of the unit frame
    assert far.sure
    assert np.abs((far.center - shift) / scale - first.middle).max() < 0.03
    assert abs(far.radius / scale - object_sphere._MARGIN * first.reach) < 0.03


def test_what_no_photo_shows_below_the_ball_does_not_count(tmp_path):
    """From above, the silhouettes leave a cone under the ball. Its tip is 1.05 below the sphere's center."""
    elevations = (60, 75)
    capture = load_capture(write_table_scene(tmp_path / "ball", radius=0, elevations=elevations))
    cells = (np.arange(64) + 0.5) / 32 - 1
    x, y, z = np.meshgrid(*(cells - middle for middle in CENTER), indexing="ij")
    lowest = np.radians(elevations[0])
    cone = np.hypot(x, y) * np.sin(lowest) - z * np.cos(lowest) - BALL
    under = np.where(z < -BALL * np.cos(lowest), cone, np.inf)
    hull = np.minimum(np.sqrt(x**2 + y**2 + z**2) - BALL, under).astype(np.float32)
    assert (hull[..., 0] < 0).any(), "the sphere cuts the cone off"
    seen = object_sphere._seen_surface(hull, PixelRays.from_capture(capture, 10_000, use_masks=False))
    assert seen[:, 2].max() > CENTER[2] + 0.95 * BALL
    assert CENTER[2] - 0.5 * BALL < seen[:, 2].min() < CENTER[2] - 0.25 * BALL


def test_a_large_enough_sphere_that_cuts_the_object_is_moved(tmp_path, monkeypatch):
    """The object is a ball of radius 0.5 around (0.7, 0, 0). What is seen of it is what lies in the sphere."""
    capture = load_capture(write_table_scene(tmp_path / "ball", radius=0))

    def hull_sphere(capture, lines, seed, check):
        place = (np.array([0.7, 0, 0]) - capture.object_center) / capture.object_radius
        size = 0.5 / capture.object_radius
        right = min(place[0] + size, 1.0)
        middle = np.array([(right + place[0] - size) / 2, 0, 0])
        return object_sphere._HullSphere(middle, size, bool(place[0] + size > 1))

    monkeypatch.setattr(object_sphere, "_hull_sphere", hull_sphere)
    found = find_object_sphere(capture)
    assert found.sure and abs(found.radius - 1.08 * 0.5) < 1e-9
    assert np.abs(found.center - [0.7, 0, 0]).max() < 1e-9


def test_the_search_can_be_ended_between_photos_and_steps(ball):
    photos = len(ball.views)

    class Ended(Exception):
        pass

    for last in (2, photos + 3):
        calls = []

        def check(done, of_all, calls=calls, last=last):
            calls.append((done, of_all))
            if len(calls) == last:
                raise Ended

        with pytest.raises(Ended):
            find_object_sphere(ball, check=check)
        assert calls[1] == (2, photos) and len(calls) == last and calls[-1] in ((2, photos), (3, object_sphere._STEPS))


@pytest.mark.slow
def test_a_sphere_that_cuts_the_object_is_kept_and_is_unsure(ball):
    small = replace(ball, object_center=CENTER + np.array([0.2, 0, 0]), object_radius=0.4)
    found = find_object_sphere(small)
    assert not found.sure and found.radius == small.object_radius and np.array_equal(found.center, small.object_center)
