"""Small copies of photos: places and cameras are carried back exactly, also where the sides do not divide evenly."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from blender_nep.cameras.reduction import Reduction
from blender_nep.capture.cameras.camera import Camera

SIZES = [(301, 201), (201, 301), (300, 200), (299, 168), (640, 3), (90, 60)]


@pytest.mark.parametrize(("width", "height"), SIZES)
@pytest.mark.parametrize("factor", [1, 3])
def test_a_spot_in_the_copy_is_at_its_place_in_the_photo(width, height, factor):
    """Spots of known centers are drawn, in an image of the photo's size or in one three times as large."""
    reduction = Reduction.of(width, height, 97)
    y, x = (np.indices((factor * height, factor * width)) + 0.5) / factor
    sigma = max(min(width, height) / 16, 1.0)
    for center in ((0.35 * width, 0.4 * height), (0.61 * width, 0.55 * height)):
        spot = 255 * np.exp(-((x - center[0]) ** 2 + (y - center[1]) ** 2) / (2 * sigma**2))
        copy = np.asarray(reduction.copy(Image.fromarray(spot.astype(np.float32)), Image.Resampling.LANCZOS), float)
        assert copy.shape == (reduction.height, reduction.width) and max(copy.shape) <= 97
        v, u = np.indices(copy.shape) + 0.5
        found = (copy * u).sum() / copy.sum(), (copy * v).sum() / copy.sum()
        in_photo = np.array(found) * reduction.scale + [reduction.left, reduction.top]
        if height > 3:  # one row says nothing about the place across it
            np.testing.assert_allclose(in_photo, center, atol=0.05)


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_cameras_are_carried_there_and_back(width, height):
    """A point is at the same place of the picture in both, and square pixels stay square."""
    camera = Camera(width, height, 250.0, 250.0, width / 2 + 3, height / 2 - 2, np.eye(4))
    reduction = Reduction.of(width, height, 97)
    small = reduction.in_copy(camera)
    assert small.fl_x == small.fl_y
    points = np.array([[0.1, 0.2, -3.0], [-0.3, 0.1, -2.0]])
    for whole, part, first in zip(camera.project(points)[:2], small.project(points)[:2], "xy", strict=True):
        cut = reduction.left if first == "x" else reduction.top
        np.testing.assert_allclose(part * reduction.scale + cut, whole, rtol=1e-12)
    back = reduction.in_photo(small, width, height)
    for name in ("width", "height", "fl_x", "fl_y", "cx", "cy"):
        assert getattr(back, name) == pytest.approx(getattr(camera, name), rel=1e-12)
