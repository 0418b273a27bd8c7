"""The search of relief: photos of a ball that mirrors known surroundings, with and without waves on its upper half."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch.nn import functional

from blender_nep.capture import PixelRays, load_capture
from blender_nep.fields.fields import Fields
from blender_nep.fields.object.field import Appearance, ObjectField
from blender_nep.fields.object.fine_level import FineLevel
from blender_nep.fields.refinements import relief
from blender_nep.fields.refinements.relief import Relief, find_relief
from blender_nep.fields.training import FieldsLearning
from blender_nep.scene.scene import Scene
from support.brief_preset import brief_preset
from support.paths import SUZANNE_SMALL

CPU = torch.device("cpu")
RADIUS, WAVE, SLOPE = 0.6, 2 * math.pi / 0.22, 0.2


def surroundings(direction: torch.Tensor) -> torch.Tensor:
    """The radiance [n, 3] from directions [n, 3]: several things in each direction."""
    frequency = torch.tensor([[4.0, 1.0, -2.0], [-1.0, 5.0, 2.0], [2.0, -3.0, 4.0]])
    return 0.4 + 0.35 * torch.sin(direction @ frequency.T + torch.tensor([0.3, 1.1, 2.5]))


def mirrored(direction: torch.Tensor, normal: torch.Tensor) -> torch.Tensor:
    return surroundings(direction - 2 * (direction * normal).sum(-1, keepdim=True) * normal)


class MirrorField(ObjectField):
    """A ball whose color is known."""

    def __init__(self):
        super().__init__(16, RADIUS)
        self.add_levels(2)

    def lit(self, paint, points, normals, directions):
        return Appearance(torch.ones_like(points), mirrored(directions, normals), paint.roughness)


def true_normals(points: torch.Tensor, slope: float) -> torch.Tensor:
    """Unit normals [n, 3] of the ball with waves where z > 0."""
    normal = functional.normalize(points, dim=-1)
    x, y, z = (WAVE * points).unbind(-1)
    steep = torch.stack([x.cos() * y.sin() * z.sin(), x.sin() * y.cos() * z.sin(), x.sin() * y.sin() * z.cos()], -1)
    steep = 2 * slope * steep * (points[:, 2:] > 0)
    return functional.normalize(normal - (steep - (steep * normal).sum(-1, keepdim=True) * normal), dim=-1)


@pytest.fixture(scope="module")
def rays():
    return PixelRays.from_capture(load_capture(SUZANNE_SMALL), 40_000, False, CPU)


def photographed(rays: PixelRays, slope: float) -> PixelRays:
    """Photos of the ball, which has waves of that slope on its upper half."""
    origins, directions, _ = rays.rays(torch.arange(rays.count))
    along = (origins * directions).sum(-1)
    depth = along.square() - origins.square().sum(-1) + RADIUS**2
    hit = depth > 0
    points = (origins + (-along - depth.clamp(min=0).sqrt())[:, None] * directions)[hit]
    radiance = surroundings(directions)
    radiance[hit] = mirrored(directions[hit], true_normals(points, slope))
    return replace(rays, radiance=radiance, exposure=1.0)


def error(field: ObjectField, slope: float, upper: bool) -> float:
    """Mean angle in degrees between the field's normals and the true ones, on the upper or the lower half."""
    points = functional.normalize(torch.randn(4000, 3, generator=torch.Generator().manual_seed(0)), dim=-1) * RADIUS
    points = points[(points[:, 2] > 0.1) if upper else (points[:, 2] < -0.1)]
    cosine = (field.normal(points) * true_normals(points, slope)).sum(-1)
    return float(torch.rad2deg(torch.arccos(cosine.clamp(-1, 1))).mean())


def test_relief_is_found_where_it_is(rays):
    torch.manual_seed(0)
    field = MirrorField()
    before = {upper: error(field, SLOPE, upper) for upper in (True, False)}
    found = find_relief(field, photographed(rays, SLOPE))
    assert found.share > 0.2 and 3 < found.tilt_deg < 25
    assert error(field, SLOPE, True) < 0.5 * before[True]
    assert error(field, SLOPE, False) < before[False] + 0.3, "the smooth half stays smooth"
    assert all(level.grad is None for level in field.levels), "the coarse levels took no part"


def test_a_smooth_ball_stays_as_it_is(rays):
    field = MirrorField()
    assert find_relief(field, photographed(rays, 0.0)) is None
    assert field.fine is None


def test_what_photos_do_not_agree_on_is_no_relief(rays):
    """Each photo of a smooth ball has errors of its own, as large as those that waves make."""
    photos = photographed(rays, 0.0)
    noise = 0.15 * torch.randn(photos.radiance.shape, generator=torch.Generator().manual_seed(1))
    assert find_relief(MirrorField(), replace(photos, radiance=(photos.radiance + noise).clamp(min=0))) is None


def test_coarse_photos_are_not_searched(rays, monkeypatch):
    monkeypatch.setattr(relief, "_search", lambda *_: pytest.fail("the photos were searched"))
    assert find_relief(MirrorField(), rays, most_pixel=0.05) is None


def test_the_mean_slope_is_that_of_a_normal_distribution():
    """Errors that grow with the square of the distance to a slope: the weights are a sampled normal distribution."""
    slopes = relief._hypotheses(torch.zeros(1))
    true = torch.tensor([[0.08, -0.05], [0.0, 0.1]])
    error = 0.5 * (slopes - true[:, None]).square().sum(-1) / 0.06**2
    mean, variance = relief._mean_slope(error, slopes, 1.0)
    torch.testing.assert_close(mean, true, rtol=0, atol=0.03)
    assert (variance > 0.002).all() and (variance < 0.012).all()  # 2 * 0.06^2 = 0.0072


def test_halves_are_correlated_block_by_block():
    generator = torch.Generator().manual_seed(0)
    first, noise = torch.randn(2, 4000, 2, generator=generator)
    block = torch.arange(4000) % 2
    second = torch.where(block[:, None] == 0, 0.6 * first + 0.8 * noise, noise)
    known = torch.ones(4000, dtype=torch.bool)
    known[:100] = False
    second[:100] = 1e3 * first[:100]
    found = relief._correlation(first, second, known, block)
    np.testing.assert_allclose(found[block == 0], 0.6, atol=0.05)
    np.testing.assert_allclose(found[block == 1], 0.0, atol=0.05)


def test_a_search_comes_when_due_and_a_resumed_run_is_the_same(rays, monkeypatch):
    searched = []

    def search(field, rays, most_pixel):
        searched.append(most_pixel)
        points = 0.6 * functional.normalize(
            torch.randn(50, 3, generator=torch.Generator().manual_seed(len(searched) % 2)), dim=-1
        )
        field.fine = FineLevel.at(points, 256, field.fine)
        with torch.no_grad():
            field.fine.coefficients.add_(1e-3)
        return Relief(0.25, 7.123)

    monkeypatch.setattr(relief, "find_relief", search)
    chosen = brief_preset(background_steps=0, steps=20, relief_at=(0.5, 0.8), relief_pixels=10.0)

    def advance(learning, steps):
        for _ in range(steps):
            learning.learn_step()
        return learning

    whole = advance(FieldsLearning(Scene.of(rays), chosen, 0), 20)
    assert len(searched) == 2
    half = advance(FieldsLearning(Scene.of(rays), chosen, 0), 12)
    resumed = FieldsLearning(Scene.of(rays), chosen, 0)
    resumed.load(half.state())
    advance(resumed, 8)
    assert len(searched) == 4, "the first search is not repeated"
    for a, b in zip(whole.object_field.parameters(), resumed.object_field.parameters(), strict=True):
        assert torch.equal(a, b)
    report = resumed.report(2.0).as_dict()
    found = report["refinements"]["relief"]
    assert found["acted"] == [0.5, 0.8] and (found["share"], found["tilt_deg"]) == (0.25, 7.123)
    copy = Fields.from_state(Fields(resumed.object_field, resumed.environment, report).state(), chosen, CPU).object_field
    points = 0.6 * functional.normalize(torch.randn(50, 3), dim=-1)
    assert torch.equal(resumed.object_field.sdf(points), copy.sdf(points))
