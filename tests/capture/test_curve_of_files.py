"""The camera's response curve, found where EXIF tells the exposures of photos of one room."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from blender_nep.capture import PixelRays, load_capture
from blender_nep.capture.exposure.curve_of_files import curve_of_files
from blender_nep.capture.exposure.surroundings import compare_exposures
from blender_nep.capture.rays.response_curve import ResponseCurve
from blender_nep.messages import Message
from blender_nep.scene.photo_analysis import PhotoAnalysis

PRIOR = 0.02


@pytest.fixture
def room(make_capture):
    """Light [N, 3] of photos from within a colored ball, as `PixelRays`, with values of 0.02 to 0.5."""
    rays = PixelRays.from_capture(load_capture(make_capture(views=30, size=48).folder), 40_000, False)
    origin, direction, _ = rays.rays(torch.arange(rays.count))
    along = (origin * direction).sum(-1)
    distance = 2.4 * float(origin.norm(dim=-1).mean())
    place = (origin + (-along + (along**2 - origin.square().sum(-1) + distance**2).sqrt())[:, None] * direction) / distance
    wave = torch.sin(5 * place + torch.tensor([0.0, 1.0, 2.0])) * torch.cos(4 * place.roll(1, -1))
    return replace(rays, radiance=torch.exp(1.4 * wave - 2.2))


def exposed(views, spread=0.35):
    log = spread * np.random.default_rng(4).standard_normal(views)
    return np.exp(log - log.mean())


def photographed(room, gains, strength):
    """The room, photographed with these exposures [views] by a camera with this curve."""
    light = room.radiance * torch.from_numpy(gains).float()[room.view_of(torch.arange(room.count))][:, None]
    return replace(room, radiance=ResponseCurve.of_files(strength).photo(light.clamp(max=0.95)))


def found_for(photos, *told):
    return curve_of_files(photos, compare_exposures(photos), *told)


@pytest.mark.parametrize(("strength", "expected"), [(0.0, 1.0), (1.0, 0.0), pytest.param(1.6, 0.0, marks=pytest.mark.slow)])
def test_the_curve_is_found_whatever_is_expected(room, strength, expected):
    gains = exposed(room.views)
    photos = photographed(room, gains, strength)
    found = found_for(photos, gains, np.zeros(room.views, int), expected, PRIOR)
    assert found.strength == pytest.approx(strength, abs=0.2)


def test_the_light_is_that_before_the_curve(room):
    gains = exposed(room.views)
    photos = photographed(room, gains, 1.0).with_curve_of_files(ResponseCurve.of_files(1.0))
    photos = photos.with_gain(torch.from_numpy(gains).float()[:, None].repeat(1, 3)).with_exposure(2.0)
    some = (photos.radiance.amax(-1) < 0.9).nonzero()[:, 0]
    torch.testing.assert_close(photos.photo(some), 2 * room.radiance[some], rtol=1e-3, atol=1e-4)
    light = photos.photo(some)
    as_file = ResponseCurve.of_files(1.0).photo(light / 2) * 2
    torch.testing.assert_close(photos.as_in_files(light), as_file)
    torch.testing.assert_close(photos.with_curve_of_files(None).as_in_files(light), light)


def test_nothing_is_told_without_different_exposures(room):
    one = np.zeros(room.views, int)
    photos = photographed(room, np.ones(room.views), 1.0)
    assert found_for(photos, None, one, 1.0, PRIOR) is None
    assert found_for(photos, np.ones(room.views), one, 1.0, PRIOR) is None
    assert found_for(photos, exposed(room.views), one, None, PRIOR) is None, "the photos hold light"
    assert found_for(photographed(room, exposed(room.views), 1.0), exposed(room.views)[::-1], one, 1.0, PRIOR) is None, (
        "the surroundings deny EXIF"
    )
    sessions = np.arange(room.views) % 2
    days = np.where(sessions == 0, 0.5, 2.0)
    assert found_for(photos, days, sessions, 1.0, PRIOR) is None, "days are not compared by EXIF"


def test_the_user_is_told_of_a_curve_that_is_undone(room):
    undone = Message("scene.curve_undone")
    for strength in (0.0, 1.0):
        rays = room.with_curve_of_files(ResponseCurve.of_files(strength))
        assert (undone in PhotoAnalysis.of(rays).sentences()) == (strength > 0)
    assert undone not in PhotoAnalysis.of(room).sentences()
