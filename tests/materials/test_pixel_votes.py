"""Every pixel's vote for a material, against a plane whose materials and light are known in closed form."""

import numpy as np
import pytest

from blender_nep.materials.labels.pixel_votes import Surfels, left_out_error, pixel_costs

STRIPE = 0.03


def light(position, photo):
    """Changes slowly over the plane, and otherwise in every photo."""
    return 1 + 0.5 * np.sin(2 * position[:, 0] + photo)[:, None] * np.array([1.0, 0.8, 0.6])


def plane(n, seed):
    rng = np.random.default_rng(seed)
    position = np.c_[rng.uniform(-0.5, 0.5, (n, 2)), np.zeros(n)]
    return Surfels(position, np.tile([0.0, 0.0, 1.0], (n, 1)), rng.integers(0, 3, n))


def stripes(position):
    return (np.floor(position[:, 0] / STRIPE) % 2).astype(int)


ALBEDO = np.array([[0.7, 0.2, 0.1], [0.3, 0.3, 0.3]])


def test_stripes_finer_than_the_samples_are_found_by_the_pixels():
    samples, pixels = plane(600, 0), plane(20_000, 1)
    shown = light(samples.position, samples.photo)[:, None] * ALBEDO
    goal = light(pixels.position, pixels.photo) * ALBEDO[stripes(pixels.position)]
    cost = pixel_costs(samples, shown, pixels, goal, clip=0.25)
    assert (cost.argmin(1) == stripes(pixels.position)).mean() > 0.99
    right = cost[np.arange(len(cost)), stripes(pixels.position)]
    assert np.median(right) < 0.02


def test_light_of_another_photo_or_the_other_side_is_not_asked():
    position, normal, photo = plane(600, 0)
    both = Surfels(np.tile(position, (2, 1)), np.concatenate([normal, -normal]), np.tile(photo, 2))
    bright = light(position, photo)[:, None] * ALBEDO
    shown = np.concatenate([bright, 0 * bright])  # the back side lies in the dark
    goal = light(position, photo) * ALBEDO[0]
    cost = pixel_costs(both, shown, Surfels(position, normal, photo), goal, clip=0.25)
    assert np.median(cost[:, 0]) < 0.02
    lonely = pixel_costs(both, shown, Surfels(position, normal, photo + 7), goal, clip=0.25)
    assert lonely == pytest.approx(0.25)


def test_samples_predict_each_other_in_slow_light_only():
    samples = plane(600, 0)
    slow = light(samples.position, samples.photo)[:, None] * ALBEDO
    assert np.median(left_out_error(samples, slow)) < 0.01
    fast = np.random.default_rng(1).uniform(0, 1, (600, 1, 3)).repeat(2, 1)  # from sample to sample another
    # |mean of four - one| of uniform numbers: between 1/4 (the mean known) and 1/3 (one neighbor alone)
    assert 0.25 < left_out_error(samples, fast).mean() < 1 / 3


def test_a_sample_alone_in_its_photo_is_predicted_by_none():
    samples = Surfels(np.zeros((3, 3)), np.tile([0.0, 0.0, 1.0], (3, 1)), np.array([0, 1, 1]))
    error = left_out_error(samples, np.full((3, 2, 3), 0.5))
    assert (error[0] == 1).all() and error[1:] == pytest.approx(0)
