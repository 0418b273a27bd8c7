"""Segments: the color of a place, and groups of places of one color."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from blender_nep.materials.place_colors import median_color
from blender_nep.materials.segments.segments import Segments, features


def checkered(n, seed):
    """Points of a square, and whether each lies on a white field. The fields are 0.25 wide."""
    position = np.c_[np.random.default_rng(seed).uniform(0, 1, (n, 2)), np.zeros(n)]
    return position, (np.floor(position[:, :2] / 0.25).sum(1) % 2).astype(bool)


def test_highlights_in_few_photos_do_not_change_a_color():
    random = np.random.default_rng(0)
    position = np.repeat(random.uniform(0, 1, (200, 3)), 9, 0)
    paint = np.repeat(random.uniform(0.1, 0.8, (200, 3)), 9, 0)
    photos = np.where((np.arange(1800) % 9 < 4)[:, None], 5.0, paint)  # four of nine photos show a highlight
    found = median_color(cKDTree(position), photos, position, 9)
    assert found == pytest.approx(np.log(paint + 0.01), abs=1e-5)


def test_the_color_does_not_depend_on_the_block(monkeypatch):
    position, white = checkered(500, 0)
    radiance = np.where(white[:, None], 0.8, 0.1) * np.ones(3)
    whole = median_color(cKDTree(position), radiance, position, 5)
    monkeypatch.setattr("blender_nep.materials.place_colors._BLOCK", 37)
    assert np.array_equal(median_color(cKDTree(position), radiance, position, 5), whole)


def test_segments_are_small_and_do_not_cross_a_color_boundary():
    position, white = checkered(6000, 1)
    color = np.log(np.where(white[:, None], [0.8, 0.5, 0.2], [0.2, 0.3, 0.6]))
    segments = Segments.of(position, color, 120, seed=0)
    counts = np.bincount(segments.label, minlength=len(segments))
    white_share = np.bincount(segments.label, white, minlength=len(segments)) / counts
    assert (counts > 0).all() and 100 <= len(segments) <= 120
    assert np.minimum(white_share, 1 - white_share).max() == 0
    for k in range(len(segments)):
        assert np.ptp(position[segments.label == k], axis=0).max() < 0.4
    assert np.array_equal(segments.near(features(position, color), 1)[1][:, 0], segments.label)


@pytest.mark.parametrize("n", [1, 3])
def test_fewer_points_than_segments(n):
    position = np.arange(3.0 * n).reshape(n, 3)
    segments = Segments.of(position, np.zeros((n, 3)), 50, seed=0)
    assert len(segments) == n and sorted(segments.label) == list(range(n))


def test_same_seed_same_segments():
    position, white = checkered(1000, 2)
    color = np.where(white[:, None], 0.0, -2.0) * np.ones(3)
    for seed in (5, 2**32 + 5):
        assert np.array_equal(Segments.of(position, color, 30, seed).label, Segments.of(position, color, 30, seed).label)
