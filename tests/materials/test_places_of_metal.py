"""Which places are metal: blotches within a color go, and what has a color of its own stays."""

import numpy as np
import pytest
import torch
from scipy.spatial import cKDTree

from blender_nep.materials.baking import Places, neighbors
from blender_nep.materials.palette.palette import Palette
from blender_nep.materials.palette.places_of_metal import PlacesOfMetal
from blender_nep.materials.palette.search import PaletteSearch

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
    return PlacesOfMetal.of(places, color, neighbors(cKDTree(places.position), places.position, 32)[1])


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
    chain = PlacesOfMetal.of(places, np.zeros((400, 3)), index)
    smoothness = 6.0
    r = 1 + 1 / (2 * smoothness) - np.sqrt((1 + 1 / (2 * smoothness)) ** 2 - 1)
    for height, width in ((1.0, 20), (3.0, 4)):  # a wide weak blotch in a metal, and a narrow strong one
        advantage = np.full(400, 0.5)
        advantage[200 : 200 + width] = -height
        away = np.abs(np.arange(400)[:, None] - np.arange(400))
        expected = (1 - r) / (1 + r) * (r**away) @ advantage > 0
        assert (chain.decide(advantage, smoothness)[50:350] == expected[50:350]).all()


def test_mixtures_of_both_classes_lie_at_boundaries_only():
    blends = Palette(torch.rand(2, 3), torch.rand(2), torch.tensor([1.0, 0.0])).with_blends()
    metal, boundary = np.array([True, False, True]), np.array([False, False, True])
    excluded = PaletteSearch.not_there(blends, metal, boundary)
    assert excluded.tolist() == [[False, True, True, True, True], [True, False, True, True, True], [False] * 5]
