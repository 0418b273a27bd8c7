"""A support plane is found by the details on which photos agree, whatever the brightness and the contrast of each photo."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from blender_nep.capture import PixelRays, load_capture
from blender_nep.support import in_photos
from blender_nep.support.by_details import correlation
from blender_nep.support.in_photos import support_in_photos
from support.table_scene import HEIGHT, write_table_scene

VIEWS, POINTS = 12, 4000


def photos_of(signal, noise, seen=1.0, seed=0):
    """Photos in each of which a pattern has another gain and offset, with noise; a share `seen` of the points is in each."""
    random = torch.Generator().manual_seed(seed)
    pattern = signal * torch.randn(1, POINTS, 3, generator=random)
    gain = 0.3 + 2 * torch.rand(VIEWS, 1, 1, generator=random)
    shown = gain * (pattern + noise * torch.randn(VIEWS, POINTS, 3, generator=random)) + gain * 7
    shown[torch.rand(VIEWS, POINTS, generator=random) > seen] = torch.nan
    return SimpleNamespace(colors=lambda points: shown, photos=shown)


@pytest.mark.parametrize("seen", [1.0, 0.5])
@pytest.mark.parametrize(("signal", "noise"), [(1.0, 0.2), (1.0, 1.0), (0.5, 1.5), (0.0, 1.0)])
def test_the_correlation_is_the_share_of_the_common_variance(signal, noise, seen):
    found = correlation(photos_of(signal, noise, seen), np.zeros((POINTS, 3)))
    assert found == pytest.approx(signal**2 / (signal**2 + noise**2), abs=0.02)


def test_photos_that_see_too_little_do_not_correlate():
    assert correlation(photos_of(1.0, 0.0, seen=0.001), np.zeros((POINTS, 3))) == 0


@pytest.fixture
def table(tmp_path):
    """A checkered table that mirrors lights, in photos of very different brightness and contrast"""
    rays = PixelRays.from_capture(
        load_capture(write_table_scene(tmp_path / "capture", glossy=True, tilt=0.3)), 10_000, False
    )
    random = torch.Generator().manual_seed(1)
    for view in range(rays.views):
        gain, gamma = 0.4 + torch.rand(3, generator=random), 0.7 + 0.6 * torch.rand(1, generator=random)
        part = slice(rays.offset[view], rays.offset[view + 1])
        rays.radiance[part] = (gain * rays.radiance[part].float() ** gamma).to(rays.radiance.dtype)
    return rays


def test_photos_of_other_brightness_and_contrast_show_the_plane(table, monkeypatch):
    support = support_in_photos(table)
    assert support is not None and support.height == pytest.approx(HEIGHT, abs=0.01)
    assert support.normal @ [np.sin(0.3), 0, np.cos(0.3)] > np.cos(np.radians(1))
    monkeypatch.setattr(in_photos, "plane_by_details", lambda photos, planes: None)
    by_color = support_in_photos(table)
    assert by_color is None or abs(by_color.height - HEIGHT) > 0.02, "the colors tell it, too: the test shows nothing"
