"""Every pixel's vote for a material, against a plane whose materials and light are known in closed form."""

import numpy as np
import pytest

from blender_nep.pixel_votes import pixel_costs

STRIPE = 0.03


def light(position, photo):
    """Changes slowly over the plane, and otherwise in every photo."""
    return 1 + 0.5 * np.sin(2 * position[:, 0] + photo)[:, None] * np.array([1.0, 0.8, 0.6])


def plane(n, seed):
    rng = np.random.default_rng(seed)
    position = np.c_[rng.uniform(-0.5, 0.5, (n, 2)), np.zeros(n)]
    return position, np.tile([0.0, 0.0, 1.0], (n, 1)), rng.integers(0, 3, n)


def stripes(position):
    return (np.floor(position[:, 0] / STRIPE) % 2).astype(int)


ALBEDO = np.array([[0.7, 0.2, 0.1], [0.3, 0.3, 0.3]])


def test_stripes_finer_than_the_samples_are_found_by_the_pixels():
    samples, pixels = plane(600, 0), plane(20_000, 1)
    shown = light(samples[0], samples[2])[:, None] * ALBEDO
    goal = light(pixels[0], pixels[2]) * ALBEDO[stripes(pixels[0])]
    cost = pixel_costs(samples, shown, pixels, goal, clip=0.25)
    assert (cost.argmin(1) == stripes(pixels[0])).mean() > 0.99
    right = cost[np.arange(len(cost)), stripes(pixels[0])]
    assert np.median(right) < 0.02


def test_light_of_another_photo_or_of_the_other_side_is_not_asked():
    position, normal, photo = plane(600, 0)
    back = (position, -normal, photo)
    both = tuple(np.concatenate(parts) for parts in zip((position, normal, photo), back, strict=True))
    bright = light(position, photo)[:, None] * ALBEDO
    shown = np.concatenate([bright, 0 * bright])  # the back side lies in the dark
    goal = light(position, photo) * ALBEDO[0]
    cost = pixel_costs(both, shown, (position, normal, photo), goal, clip=0.25)
    assert np.median(cost[:, 0]) < 0.02
    lonely = pixel_costs(both, shown, (position, normal, photo + 7), goal, clip=0.25)
    assert lonely == pytest.approx(0.25)
