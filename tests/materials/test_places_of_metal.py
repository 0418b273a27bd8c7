"""Which places are metal: blotches within a color go, and what has a color of its own stays."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from blender_nep.materials.baking import Places, neighbors
from blender_nep.materials.palette.places_of_metal import PlacesOfMetal, advantage_of_metal, not_there

SIDE = 40
SMOOTHNESS = 30.0


@pytest.fixture
def plate():
    """The places of a square plate, and their log colors: brown on the left side, black on the right one."""
    u = (np.arange(SIDE) + 0.5) / SIDE
    position = np.stack([*np.meshgrid(u, u), np.zeros((SIDE, SIDE))], -1).reshape(-1, 3)
    brown = position[:, 0] < 0.6
    color = np.log(np.where(brown[:, None], [0.3, 0.2, 0.1], [0.02, 0.02, 0.025]))
    return Places(position, np.tile([0.0, 0, 1], (len(position), 1))), color, brown


def graph(places, color):
    tree = cKDTree(places.position)
    return PlacesOfMetal.of(places, tree, color, neighbors(tree, places.position, 32)[1])


def blotches(places, seed=0):
    """An advantage of metal [n] that is wrong in smooth blotches on a third of the places."""
    random, x = np.random.default_rng(seed), places.position
    waves = sum(np.cos(x[:, :2] @ (9 * random.standard_normal(2)) + 6 * random.random()) for _ in range(6))
    return np.where(waves > np.quantile(waves, 0.34), 1.0, -1.0) * 0.1 * random.random(len(x))


def test_a_uniform_metal_has_no_blotches_and_ends_at_the_color(plate):
    places, color, brown = plate
    advantage = blotches(places) * np.where(brown, 1, -1)
    alone = (advantage > 0) == brown
    found = graph(places, color).decide(advantage, SMOOTHNESS) == brown
    assert alone.mean() < 0.7 and found.mean() > 0.97


def test_a_small_thing_of_another_color_stays(plate):
    places, color, brown = plate
    knob = np.linalg.norm(places.position[:, :2] - [0.3, 0.5], axis=1) < 0.08
    color[knob] = np.log([0.5, 0.5, 0.55])
    advantage = np.where(brown & ~knob, 0.05, -0.05)
    assert (graph(places, color).decide(advantage, SMOOTHNESS) == (brown & ~knob)).mean() > 0.98


def test_the_smooth_advantage_solves_its_equation():
    """On a chain of places of one color, the smoothing is a convolution with a known kernel: r^|i - j|."""
    places = Places(np.stack([np.arange(400.0), np.zeros(400), np.zeros(400)], 1), np.tile([0.0, 0, 1], (400, 1)))
    index = np.clip(np.arange(400)[:, None] + [0, -1, 1], 0, 399)
    chain = PlacesOfMetal.of(places, cKDTree(places.position), np.zeros((400, 3)), index)
    smoothness = 6.0
    r = 1 + 1 / (2 * smoothness) - np.sqrt((1 + 1 / (2 * smoothness)) ** 2 - 1)
    for height, width in ((1.0, 20), (3.0, 4)):  # a wide weak blotch in a metal, and a narrow strong one
        advantage = np.full(400, 0.5)
        advantage[200 : 200 + width] = -height
        away = np.abs(np.arange(400)[:, None] - np.arange(400))
        expected = (1 - r) / (1 + r) * (r**away) @ advantage > 0
        assert (chain.decide(advantage, smoothness)[50:350] == expected[50:350]).all()


def test_mixtures_of_both_classes_lie_at_boundaries_only():
    metallic = np.array([1.0, 0.0, 0.75, 0.5, 0.25])
    metal, boundary = np.array([True, False, True]), np.array([False, False, True])
    excluded = not_there(metallic, metal, boundary)
    assert excluded.tolist() == [[False, True, True, True, True], [True, False, True, True, True], [False] * 5]


def test_other_places_are_as_the_samples_around_them(plate):
    places, color, brown = plate
    away = np.array([[0.2, 0.31, 0.0], [0.9, 0.52, 0.0], [0.6, 0.41, 0.0]])
    at = Places(away, np.tile([0.0, 0, 1], (3, 1)))
    metal, boundary = graph(places, color).around(brown, at)
    assert metal[:2].tolist() == [True, False] and boundary.tolist() == [False, False, True]


def test_classes_that_photos_tell_apart_need_no_smoothing():
    cost = np.array([[0.02, 0.2, 0.3], [0.2, 0.03, 0.1]] * 10)
    metallic = np.array([1.0, 0.0, 0.0])
    assert advantage_of_metal(cost, metallic, 0.6) is None
    np.testing.assert_allclose(advantage_of_metal(cost + 0.2, metallic, 0.6)[:2], [0.18, -0.17])
    assert advantage_of_metal(cost + 0.2, np.ones(3), 0.6) is None
    assert advantage_of_metal(cost + 0.2, metallic, np.inf) is None
