"""Blender's side and the library have a copy each of the sRGB curve."""

import numpy as np

from backend.scene_io import srgb
from blender_nep import color


def test_both_copies_are_the_same_curve():
    values = np.linspace(0, 1, 1001)
    np.testing.assert_allclose(srgb.srgb_to_linear(values), color.srgb_to_linear(values), rtol=1e-6)
    np.testing.assert_allclose(srgb.linear_to_srgb(values), color.linear_to_srgb(values), rtol=1e-6)


def test_the_curve_is_inverted_and_clipped():
    values = np.linspace(0, 1, 101)
    np.testing.assert_allclose(srgb.srgb_to_linear(srgb.linear_to_srgb(values)), values, atol=1e-6)
    np.testing.assert_allclose(srgb.linear_to_srgb(np.array([-1.0, 7.0])), [0, 1], atol=1e-12)
