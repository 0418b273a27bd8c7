"""Light of which photos show no more than white: it counts as brighter, and photos are explained as before."""

import math
from dataclasses import replace

import pytest
import torch

from benchmarks.suite.plan import ABLATIONS, AT_WHITE
from blender_nep.capture import load_capture
from blender_nep.capture.rays.pixel_rays import PixelRays
from blender_nep.fields.environment.field import EnvironmentField
from blender_nep.fields.environment.training import freeze
from blender_nep.presets import EnvironmentPreset

PRESET = EnvironmentPreset(
    resolutions=((8, 24), (10, 32)), refine_at=(0.5,), contraction_radius=20.0, coverage_weight=1e-7, burnt_gain=3.0
)
UP, ACROSS = torch.tensor([[0.6, 0.0, 0.8]]), torch.tensor([[1.0, 0.0, 0.0]])
DOWN = -UP
RAYS = 30_000


def all_around(count: int = RAYS) -> torch.Tensor:
    generator = torch.Generator().manual_seed(0)
    return torch.nn.functional.normalize(torch.randn(count, 3, generator=generator), dim=-1)


def gray_sky(preset: EnvironmentPreset = PRESET) -> EnvironmentField:
    """A radiance of 1 far away."""
    field = EnvironmentField(preset, mean_radiance=1.0)
    with torch.no_grad():
        field.raw[..., 0] = -12
    return field


def radiance(field: EnvironmentField, direction: torch.Tensor, half_angle: float) -> float:
    return float(field.query_cone(torch.zeros(1, 3), direction, half_angle)[0].mean())


def test_cones_are_brighter_by_the_gain_where_photos_end_at_white():
    """A gray sky, whose upper half is white in all photos. A cone across sees half of each. So much may be lamps here."""
    field, directions = gray_sky(replace(PRESET, backdrop_share=(0.9, 0.95))), all_around(100_000)
    field.freeze(-2 * directions, directions, directions[:, 2] > 0)
    assert radiance(field, UP, 0.2) == pytest.approx(3, rel=0.02)
    assert radiance(field, DOWN, 0.2) == pytest.approx(1, rel=0.02)
    assert radiance(field, ACROSS, 0.7) == pytest.approx(2, rel=0.03)
    _, coverage = field.query_cone(torch.zeros(2, 3), torch.cat([UP, DOWN]), 0.2)
    torch.testing.assert_close(coverage, torch.ones(2), atol=0.02, rtol=0)
    whole = field.extrapolated(8).mean(-1)
    torch.testing.assert_close(whole[:3], torch.full((3, 16), 3.0), rtol=0.02, atol=0)
    torch.testing.assert_close(whole[5:], torch.ones(3, 16), rtol=0.02, atol=0)


def test_photos_are_explained_without_the_gain():
    field, directions = gray_sky(), all_around()
    near = torch.full((100,), PRESET.camera_near)
    before = field.render(-2 * directions[:100], directions[:100], near, near * math.inf).radiance
    field.freeze(-2 * directions, directions, directions @ UP[0] > 0.85)
    after = field.render(-2 * directions[:100], directions[:100], near, near * math.inf).radiance
    assert radiance(field, UP, 0.2) == pytest.approx(3, rel=0.02)
    assert torch.equal(before, after)


@pytest.mark.parametrize(("share", "gain"), [(0.05, 3.0), (0.2, math.sqrt(3)), (0.4, 1.0)])
def test_a_white_backdrop_is_hardly_brighter_than_white(share, gain):
    """White is in a cap that holds this share of all directions: a lamp, half of both, a backdrop."""
    field, directions = gray_sky(), all_around()
    field.freeze(-2 * directions, directions, directions @ UP[0] > 1 - 2 * share)
    assert radiance(field, UP, 0.1) == pytest.approx(gain, rel=0.03)
    assert radiance(field, DOWN, 0.2) == pytest.approx(1, rel=0.02)


def test_the_ablation_leaves_it_at_white():
    preset = replace(PRESET, **ABLATIONS[AT_WHITE]["environment"])
    field, directions = gray_sky(preset), all_around()
    field.freeze(-2 * directions, directions, directions @ UP[0] > 0.85)
    assert radiance(field, UP, 0.2) == pytest.approx(1, rel=0.02)


def test_light_that_other_photos_show_below_white_counts_less():
    field, directions = gray_sky(), all_around()
    field.freeze(-2 * directions, directions, (torch.arange(RAYS) % 2 == 0) & (directions @ UP[0] > 0.7))
    assert radiance(field, UP, 0.3) == pytest.approx(math.sqrt(3), rel=0.05)


def test_a_saved_field_is_as_bright():
    field, directions = gray_sky(), all_around()
    field.refine(1.0)
    field.freeze(-2 * directions, directions, directions @ UP[0] > 0.85)
    restored = EnvironmentField(PRESET)
    restored.load_state_dict(field.state_dict())
    assert radiance(restored, UP, 0.2) == radiance(field, UP, 0.2) == pytest.approx(3, rel=0.02)


def test_only_pixels_with_all_channels_at_white_are_burnt_light(make_capture):
    rays = PixelRays.from_capture(load_capture(make_capture(views=3, size=16).folder), 1000, False)
    values = torch.full_like(rays.radiance, 0.5)
    values[0], values[1], values[2] = (
        torch.tensor([1.0, 1.0, 1.0]),
        torch.tensor([1.0, 0.4, 0.2]),
        torch.tensor([0.9, 0.9, 0.9]),
    )
    rays, index = replace(rays, radiance=values), torch.arange(4)
    assert rays.burnt_out(index).tolist() == [True, True, False, False]
    assert rays.white(index).tolist() == [True, False, False, False]
    bright = replace(rays, radiance=2 * values)
    assert not bright.burnt_out(index).any() and not bright.white(index).any()


def test_photos_of_a_larger_range_are_brightened_nowhere(make_capture):
    rays = PixelRays.from_capture(load_capture(make_capture(views=3, size=16).folder), 1000, False)
    lamps = torch.where(torch.arange(rays.count)[:, None] % 20 == 0, 1.0, 0.5).expand(-1, 3).contiguous()
    for factor, gained in ((1.0, True), (2.0, False)):
        field = gray_sky()
        freeze(field, replace(rays, radiance=factor * lamps), torch.arange(rays.count), 0)
        assert bool((field.query_cone(torch.zeros(200, 3), all_around(200), 0.3)[0] > 1.02).any()) == gained
