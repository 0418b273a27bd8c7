"""Where label pixels may show a mixture of two materials."""

import numpy as np
from scipy.spatial import cKDTree

from blender_nep.materials.labels.labeled_points import shows_one_material

BLENDED = np.array([False, False, True])


def plane_of_two(points, width):
    """Costs [n, 3] of two materials and their mixture on a plane: mixed within `width` of x = 0.5, pure elsewhere."""
    x = points[:, 0]
    true = np.where(np.abs(x - 0.5) < width, 2, np.where(x < 0.5, 0, 1))
    return np.where(np.arange(3) == true[:, None], 0.02, 0.1)


def test_noise_in_a_material_is_found_not_in_a_broad_boundary():
    random = np.random.default_rng(4)
    points = random.uniform(size=(20_000, 3)) * [1, 1, 0]
    cost = plane_of_two(points, 0.1)
    noisy = (random.uniform(size=len(points)) < 0.1) & (np.abs(points[:, 0] - 0.5) > 0.1)
    cost[noisy] = [0.1, 0.1, 0.02]
    inner = shows_one_material(cost, BLENDED, cKDTree(points))
    assert inner[np.abs(points[:, 0] - 0.5) > 0.15].all()
    assert not inner[np.abs(points[:, 0] - 0.5) < 0.05].any()


def test_without_mixtures_nothing_is_found():
    points = np.random.default_rng(5).uniform(size=(50, 3))
    assert not shows_one_material(np.ones((50, 2)), np.array([False, False]), cKDTree(points)).any()
