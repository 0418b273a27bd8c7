"""Gains of photos: known ones are found again in a room of known size and in rendered photos; else none are found."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from blender_nep.capture import PixelRays, load_capture
from blender_nep.capture.exposure import SPHERES, find_gains, stops
from blender_nep.fields.environment_learning import geometric_mean
from blender_nep.scene_analysis import SceneAnalysis

SMALL = Path(__file__).parents[1] / "data" / "suzanne_small"
TENTH_OF_A_STOP = 0.07
"""ln 2 / 10"""


def gains(views: int, deviation: float, seed: int, hue: float = 0.0) -> torch.Tensor:
    """Random factors [views, 3] of geometric mean 1; deviations of the logarithms, together and of each channel."""
    random = torch.Generator().manual_seed(seed)
    log = deviation * torch.randn(views, 1, generator=random) + hue * torch.randn(views, 3, generator=random)
    return (log - log.mean(0)).exp()


def taken_with(rays: PixelRays, gain: torch.Tensor) -> PixelRays:
    return replace(rays, radiance=rays.radiance * gain[rays.view_of(torch.arange(rays.count))])


def difference(found: torch.Tensor, true: torch.Tensor) -> float:
    return float((found.log() - true.log()).square().mean().sqrt())


@pytest.fixture(params=[SPHERES[4], 4.1], ids=["on a sphere", "between two"])
def in_a_ball(make_capture, request):
    """Photos from within a coloured ball, of a radius in camera distances; each sees a sixth of it."""
    rays = PixelRays.from_capture(load_capture(make_capture(views=24, size=64).folder), 40_000, False)
    origin, direction, _ = rays.rays(torch.arange(rays.count))
    distance = request.param * float(origin.norm(dim=-1).mean())
    along = (origin * direction).sum(-1)
    t = -along + (along**2 - origin.square().sum(-1) + distance**2).sqrt()
    place = (origin + t[:, None] * direction) / distance
    colour = 0.3 + 0.2 * torch.sin(5 * place + torch.tensor([0.0, 1.0, 2.0])) * torch.cos(4 * place.roll(1, -1))
    return replace(rays, radiance=colour)


@pytest.mark.parametrize("seed", range(3))
def test_known_exposures_and_white_balances_are_found_again(in_a_ball, seed):
    true = gains(in_a_ball.views, 0.4, seed, hue=0.1)
    found = find_gains(taken_with(in_a_ball, true))
    assert difference(found, true) < TENTH_OF_A_STOP
    torch.testing.assert_close(found.log().mean(0), torch.zeros(3), atol=1e-5, rtol=0)


def test_photos_of_one_exposure_are_left_alone(in_a_ball):
    assert find_gains(in_a_ball) is None
    rays = PixelRays.from_capture(load_capture(SMALL), 40_000, False)
    assert find_gains(rays) is None


@pytest.mark.parametrize("deviation", [0.25, 0.7])
def test_exposures_of_rendered_photos_are_found_within_a_tenth_of_a_stop(deviation):
    rays = PixelRays.from_capture(load_capture(SMALL), 40_000, False)
    true = gains(rays.views, deviation, 4)
    assert difference(find_gains(taken_with(rays, true)), true) < TENTH_OF_A_STOP


def test_what_is_white_in_a_file_says_nothing(in_a_ball):
    true = gains(in_a_ball.views, 0.4, 5)
    clipped = taken_with(in_a_ball, 1.2 * true)
    clipped = replace(clipped, radiance=clipped.radiance.clamp(max=1))
    assert (clipped.radiance == 1).any(-1).float().mean() > 0.05
    assert difference(find_gains(clipped), true) < TENTH_OF_A_STOP


def test_it_is_not_told_where_it_cannot_be(in_a_ball, make_capture):
    alone = make_capture(views=8, masks=True, alpha=True, name="cut").folder
    cut = PixelRays.from_capture(load_capture(alone), 40_000, True)
    assert not cut.background and find_gains(cut) is None
    dark = replace(in_a_ball, radiance=torch.zeros_like(in_a_ball.radiance))
    assert find_gains(dark) is None
    noise = torch.rand(in_a_ball.radiance.shape, generator=torch.Generator().manual_seed(0))
    assert find_gains(replace(in_a_ball, radiance=noise)) is None


def test_a_photo_that_shares_nothing_with_others_keeps_its_exposure(in_a_ball):
    true = gains(in_a_ball.views, 0.4, 6)
    rays = taken_with(in_a_ball, true)
    rays.radiance[rays.offset[3]:rays.offset[4]] = 0
    found = find_gains(rays)
    assert torch.equal(found[3].round(decimals=4), found[3][:1].expand(3).round(decimals=4)) and found.isfinite().all()
    others = [v for v in range(rays.views) if v != 3]
    log = (found.log() - true.log())[others]
    assert float((log - log.mean(0)).square().mean().sqrt()) < TENTH_OF_A_STOP


def test_photos_are_read_as_of_one_exposure_and_the_scene_says_so(in_a_ball):
    true = gains(in_a_ball.views, 0.5, 7)
    rays = taken_with(in_a_ball, true).with_gain(true)
    index = torch.tensor([0, 5, rays.offset[9] + 3, rays.count - 1])
    torch.testing.assert_close(rays.photo(index), in_a_ball.radiance[index], rtol=1e-5, atol=1e-6)
    assert torch.equal(in_a_ball.photo(index), in_a_ball.radiance[index])
    assert stops(true) == pytest.approx((true.log()[:, 0] / np.log(2)).tolist(), abs=0.006)
    spread = np.ptp(stops(true))
    assert f"exposures differ by up to {spread:.1f} stops" in " ".join(SceneAnalysis.of(rays).sentences())
    assert "exposures" not in " ".join(SceneAnalysis.of(in_a_ball).sentences())
    assert geometric_mean(rays) > 0
