"""The upward direction is found from upright cameras, from a few rolled ones, and from cameras that look along one line."""

import numpy as np
import pytest

from blender_nep.capture.cameras.upright import upward
from support.table_scene import turn

UP = np.array([0.0, 0.0, 1.0])


@pytest.fixture
def rotations() -> np.ndarray:
    """Rotations [12, 3, 3] of upright cameras that look at the origin from random places above it."""
    rng, found = np.random.default_rng(0), []
    for angle in rng.uniform(0, 2 * np.pi, 12):
        back = np.array([np.cos(angle), np.sin(angle), rng.uniform(0.1, 1)])
        back /= np.linalg.norm(back)
        right = np.cross(UP, back)
        right /= np.linalg.norm(right)
        found.append(np.stack([right, np.cross(back, right), back], 1))
    return np.stack(found)


def of(rotations: np.ndarray) -> np.ndarray:
    return upward(rotations[:, :, 0], rotations[:, :, 1])


def test_upright_cameras_tell_it_exactly_in_any_frame(rotations):
    np.testing.assert_allclose(of(rotations), UP, atol=1e-9)
    np.testing.assert_allclose(of(turn(2.0) @ rotations), turn(2.0) @ UP, atol=1e-9)


def test_a_rolled_camera_does_not_tip_it(rotations):
    rotations[0] = rotations[0] @ turn(0.1)[np.ix_([0, 2, 1], [0, 2, 1])]
    assert of(rotations) @ UP > 0.99


def test_cameras_along_one_line_give_the_mean_of_their_own(rotations):
    nearly_alike = np.stack([turn(angle)[np.ix_([0, 2, 1], [0, 2, 1])] for angle in (-0.02, 0.0, 0.02)])
    alike = rotations[:1] @ nearly_alike
    np.testing.assert_allclose(of(alike), rotations[0][:, 1], atol=1e-6)
