"""An improved camera is held near the given one where its photo shows little."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from blender_nep.cameras.alignment import angle
from blender_nep.cameras.held_camera import Spread, held, off
from support.printed_room import camera

TRUE = camera(3, 16)
SPREAD = Spread(turn=np.radians(0.1), shift=0.01, features=0.2)


def changed(seed, spread=SPREAD):
    """The true camera with an error as the spread says."""
    random, matrix = np.random.default_rng(seed), TRUE.camera_to_world.copy()
    matrix[:3, :3] = Rotation.from_rotvec(random.normal(size=3) * spread.turn).as_matrix() @ matrix[:3, :3]
    matrix[:3, 3] += random.normal(size=3) * spread.shift
    return replace(TRUE, camera_to_world=matrix)


def features(count, seed, wide=1.0):
    """Random scene points in a middle part of the photo, and where the photo shows them."""
    random = np.random.default_rng(seed)
    x = TRUE.width * (0.5 + wide * random.uniform(-0.5, 0.5, count))
    y = TRUE.height * (0.5 + wide * random.uniform(-0.5, 0.5, count))
    points = TRUE.position + random.uniform(2, 4, count)[:, None] * TRUE.directions(x, y)
    return np.column_stack([x + random.normal(size=count) * 0.2, y + random.normal(size=count) * 0.2, points])


def error(found):
    """Turn [degrees] and shift [radii] between the camera and the true one."""
    turn = angle(found.camera_to_world[:3, :3] @ TRUE.camera_to_world[:3, :3].T)
    return np.array([turn, np.linalg.norm(found.position - TRUE.position)])


def test_many_points_decide():
    given, wrong = changed(0), changed(1, Spread(np.radians(3), 0.1, 0.2))
    seen = features(400, 2)
    found = held(given, wrong, seen, SPREAD)
    assert (error(found) < 0.3 * error(given)).all()
    assert np.median(np.linalg.norm(off(found, seen), axis=1)) < 0.3


def test_few_points_in_one_place_hardly_move_the_camera():
    """The points alone make such a camera worse than it was given; held, it is better than both, in the mean."""
    errors = []
    for seed in range(20):
        given, seen = changed(seed), features(8, seed, wide=0.05)
        loose = held(given, given, seen, Spread(np.radians(20), 2.0, 0.2))
        errors.append([error(given), error(loose), error(held(given, loose, seen, SPREAD))])
    before, alone, after = np.mean(errors, 0)
    assert (alone > 1.5 * before).all() and (after < before).all()


def test_a_camera_that_was_given_wrongly_is_let_go():
    matrix = TRUE.camera_to_world.copy()
    matrix[:3, :3] = Rotation.from_rotvec([0, 0, 0.3]).as_matrix() @ matrix[:3, :3]
    found = held(replace(TRUE, camera_to_world=matrix), TRUE, features(400, 5), SPREAD)
    assert error(found)[0] < 0.1


@pytest.mark.parametrize("exact", [Spread(0.0, 0.0, 0.2), Spread(1e-9, 1e-9, 0.2)])
def test_cameras_without_error_stay(exact):
    found = held(TRUE, changed(4), features(400, 6), exact)
    assert np.abs(found.camera_to_world - TRUE.camera_to_world).max() < 1e-6


def test_a_photo_without_points_has_the_given_camera():
    given = changed(7)
    assert error(held(given, changed(8), np.zeros((0, 5)), SPREAD)) == pytest.approx(error(given), abs=1e-6)
