"""Vignetting: a known one is found again and divided out, and none is found where there is none."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from blender_nep.capture import PixelRays, load_capture
from blender_nep.capture.doctor.summary import describe, summarize
from blender_nep.capture.exposure.surroundings import compare_exposures
from blender_nep.capture.rays.vignetting import Vignetting
from blender_nep.scene.photo_analysis import PhotoAnalysis
from support.exposures import find_exposures
from support.paths import SUZANNE_SMALL

HALF_A_STOP, A_STOP = Vignetting(-0.35, 0.0), Vignetting(-0.3, -0.4)
TENTH_OF_A_STOP = 0.07
BIAS = 0.03
"""Largest error of the logarithm of the corners' gain, without vignetting too: real surroundings are not spheres."""


@pytest.fixture(scope="module")
def rays():
    return PixelRays.from_capture(load_capture(SUZANNE_SMALL), 40_000, False)


def seen_through(rays, lens):
    return replace(rays, radiance=rays.radiance * lens.at(rays.from_middle(torch.arange(rays.count)))[:, None])


def test_the_middle_and_the_corners_of_a_photo(make_capture):
    rays = PixelRays.from_capture(load_capture(make_capture(views=3, size=40).folder), 40_000, False)
    square = rays.from_middle(torch.arange(rays.offset[1], rays.offset[2])).view(rays.size[1])
    height, width = square.shape
    corner = ((width - 1) ** 2 + (height - 1) ** 2) / (width**2 + height**2)
    assert square[0, 0] == square[-1, -1] == square[0, -1] == pytest.approx(corner)
    assert square[height // 2 - 1 : height // 2 + 1].min() == pytest.approx(2 / (width**2 + height**2))


def test_the_gain_is_a_polynomial_of_its_logarithm():
    square = torch.tensor([0.0, 0.25, 1.0], dtype=torch.float64)
    expected = [1.0, math.exp(-0.3 / 4 - 0.4 / 16), math.exp(-0.7)]
    torch.testing.assert_close(A_STOP.at(square), torch.tensor(expected, dtype=torch.float64))
    assert A_STOP.corner_stops == pytest.approx(-0.7 / math.log(2))


@pytest.mark.parametrize("lens", [HALF_A_STOP, A_STOP])
def test_a_known_vignetting_is_found_and_divided_out(rays, lens):
    gain = torch.linspace(-0.5, 0.5, rays.views).exp()
    dark = seen_through(rays, lens)
    taken = replace(dark, radiance=dark.radiance * gain[rays.view_of(torch.arange(rays.count))][:, None])
    found = find_exposures(taken)
    assert found.vignetting is not None and found.gain is not None
    places = torch.linspace(0, 1, 11)
    assert (found.vignetting.at(places).log() - lens.at(places).log()).abs().max() < BIAS
    index = rays.outside[:: max(1, len(rays.outside) // 5000)]
    even = taken.with_gain(found.gain, found.vignetting).photo(index) / rays.photo(index).clamp(min=1e-6)
    shown = rays.photo(index).amin(-1) > 1e-3
    assert even[shown].log().std() < TENTH_OF_A_STOP < (taken.photo(index) / rays.photo(index))[shown].log().std() / 4


def test_nothing_is_found_without_vignetting_or_dark_corners(rays):
    assert find_exposures(rays).vignetting is None
    assert find_exposures(seen_through(rays, Vignetting(0.5, 0.2))).vignetting is None


def test_a_dark_ring_is_no_vignetting(rays):
    """Seen in photos of a museum's turntable: the logarithm falls to -2.4 at three quarters of the way, and rises again."""
    ring = Vignetting(-8.6, 7.8)
    assert not ring.darkest_at_corners and HALF_A_STOP.darkest_at_corners and A_STOP.darkest_at_corners
    assert Vignetting(-1.0, 0.55).darkest_at_corners, "a fit may turn up a little at a flat rim"
    compared = compare_exposures(seen_through(rays, A_STOP))
    assert compared.vignetting is not None
    assert replace(compared, falloff=np.array([ring.square, ring.fourth])).vignetting is None


def test_an_artist_is_told(rays, monkeypatch):
    dark = seen_through(rays, A_STOP)
    even = dark.with_gain(None, find_exposures(dark).vignetting)
    assert any(line.code == "scene.vignetting" for line in PhotoAnalysis.of(even).sentences())
    assert not any(line.code == "scene.vignetting" for line in PhotoAnalysis.of(rays).sentences())
    monkeypatch.setattr(PixelRays, "from_capture", lambda *_, **__: dark)
    found = summarize(SUZANNE_SMALL)
    assert found["corner_stops"] == pytest.approx(-1, abs=0.1) and "corners 1.0" in describe(found)
