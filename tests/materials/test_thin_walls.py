"""The two sides of a thin wall may have different paints, and photos may show one side much more often than the other."""

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

from blender_nep.geometry.mesh import Surface
from blender_nep.materials.baking import (
    LabeledPoints,
    Places,
    bake,
    kernel,
    labels_at,
    neighbors,
    on_same_side,
    weighted_mean,
)
from blender_nep.shading.plenoptic import SurfacePoints

OUTSIDE, INSIDE = np.array([0.8, 0.1, 0.1]), np.array([0.1, 0.1, 0.8])


def wall(thickness: float) -> Surface:
    """Two squares of side 1, back to back: the outer side looks up, and its chart is the left half of the atlas."""
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
    sides = [np.c_[square, np.full(4, z)] for z in (thickness / 2, -thickness / 2)]
    faces = np.array([[0, 1, 2], [0, 2, 3], [4, 6, 5], [4, 7, 6]])
    normals = np.repeat([[0.0, 0, 1], [0.0, 0, -1]], 4, 0)
    uv = np.concatenate([square * [0.5, 1], square * [0.5, 1] + [0.5, 0]])
    return Surface(np.concatenate(sides), faces, normals, uv)


def labeled(thickness: float, outer: int, inner: int) -> LabeledPoints:
    random, n = np.random.default_rng(0), outer + inner
    up = np.where(np.arange(n) < outer, 1.0, -1.0)
    position = np.c_[random.uniform(size=(n, 2)), up * thickness / 2]
    normal = np.c_[np.zeros((n, 2)), up]
    albedo = np.where(up[:, None] > 0, OUTSIDE, INSIDE)
    photo = np.where(up > 0, random.integers(20, size=n), 0)
    zero = np.zeros(n)
    return LabeledPoints(position, normal, photo, albedo, 0.5 + 0.2 * up, zero, zero)


@pytest.mark.parametrize(("inner", "most_wrong"), [(4000, 0.02), (2000, 0.2)])
def test_paint_does_not_come_through_a_wall(inner, most_wrong):
    surface, points = wall(0.01), labeled(0.01, 4000, inner)
    albedo, roughness, _, confidence = bake(surface, points, 64)
    left, right = (slice(None), slice(0, 31)), (slice(None), slice(33, 64))
    outer = (np.abs(albedo[left] - OUTSIDE).max(-1) > 1e-6) | (np.abs(roughness[left] - 0.7) > 1e-6)
    assert outer.mean() < 0.02
    wrong = np.abs(albedo[right] - INSIDE).max(-1) > 1e-6
    assert wrong.mean() < most_wrong, "where hardly any neighbor is on the same side, all count"
    assert confidence[right].mean() < 0.5 * confidence[left].mean(), "one photo shows the inner side, many the outer one"


def test_neighbors_of_a_smooth_surface_stay_as_they_are():
    random = np.random.default_rng(1)
    normal = random.normal(size=(500, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    distance, index = neighbors(cKDTree(normal), normal, 16)
    same = on_same_side((distance, index), Places(normal, normal), Places(normal, normal))
    assert same[0] is distance and same[1] is index


def test_the_two_sides_of_a_groove_are_neighbors():
    """Their normals look at each other. Turned around, the same two planes are a wall."""
    random = np.random.default_rng(2)
    side = np.repeat([1.0, -1.0], 200)
    position = np.c_[random.uniform(size=(400, 2)), 0.005 * side]
    found = neighbors(cKDTree(position), position, 16)
    groove, thin = (Places(position, np.c_[np.zeros((400, 2)), turn * side]) for turn in (-1, 1))
    assert on_same_side(found, groove, groove)[0] is found[0]
    assert np.isinf(on_same_side(found, thin, thin)[0]).mean() == pytest.approx(0.5, abs=0.05)


def test_weights_of_neighbors_that_do_not_count():
    distance = np.array([[0.0, 1.0, 2.0], [np.inf, np.inf, np.inf], [1.0, np.inf, 2.0]])
    weight = kernel(distance)
    np.testing.assert_allclose(weight[0], np.exp(-2.3 * np.array([0, 0.25, 1])))
    np.testing.assert_allclose(weight[1], 1)
    np.testing.assert_allclose(weight[2], [np.exp(-2.3 * 0.25), 0, np.exp(-2.3)])
    cost = np.array([[1.0], [5.0], [3.0]])
    assert weighted_mean(cost, distance, np.tile([0, 1, 2], (3, 1)))[1] == pytest.approx(3)


def test_a_point_takes_the_label_of_its_own_side():
    known = labeled(0.01, 400, 400)
    at = torch.tensor([[0.3, 0.3, -0.005], [0.6, 0.6, 0.005]], dtype=torch.float64)
    normal = torch.tensor([[0.0, 0, -1], [0.0, 0, 1]], dtype=torch.float64)
    points = SurfacePoints(at, np.zeros(2, int), normal, normal)
    label = torch.from_numpy((known.normal[:, 2] > 0).astype(np.int64))
    assert labels_at(cKDTree(known.position), Places(known.position, known.normal), label, points).tolist() == [0, 1]


def test_a_search_for_neighbors_takes_as_many_threads_as_the_job(monkeypatch):
    class Tree:
        n = 5

        def query(self, points, k, workers):
            asked.append(workers)
            return np.zeros((len(points), k)), np.zeros((len(points), k), int)

    asked, before = [], torch.get_num_threads()
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            neighbors(Tree(), np.zeros((3, 3)), 2)
    finally:
        torch.set_num_threads(before)
    assert asked == [1, 2]
