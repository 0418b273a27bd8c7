"""The kernels on extreme input, fuzzed: finite values and gradients, and both bodies of a kernel say the same."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

pytest.importorskip("hypothesis")
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from blender_nep.fields.environment.field import EnvironmentField
from blender_nep.fields.object.field import SplineShape
from blender_nep.fields.object.volume_rendering import render_surface, sphere_interval
from blender_nep.materials.fitting import fit_groups
from blender_nep.materials.palette.palette import best_of
from blender_nep.ops.environment.rendering import EnvironmentVolume, render_environment
from blender_nep.ops.environment.segments import RaySegments
from blender_nep.ops.environment.smoothness import total_variation
from blender_nep.ops.object import bspline
from blender_nep.ops.object.bspline_march import march
from blender_nep.ops.object.touched import touched_mean_square
from blender_nep.presets import EnvironmentPreset
from blender_nep.shading import brdf
from blender_nep.shading.cones import diffuse_cones, specular_cones
from blender_nep.shading.plenoptic import SpecularMoments

FUZZ = settings(max_examples=25, derandomize=True, database=None, deadline=None, suppress_health_check=list(HealthCheck))
SEEDS = st.integers(0, 1000)
LOW = (torch.bfloat16, torch.float16)


def rays_from(distance: float, n: int, seed: int, dtype=torch.float32) -> tuple[torch.Tensor, torch.Tensor]:
    """Rays from `distance` towards, past and, one in four, exactly through the object's center."""
    generator = torch.Generator().manual_seed(seed)
    origins = torch.nn.functional.normalize(torch.randn(n, 3, generator=generator, dtype=torch.float64), dim=-1) * distance
    aim = 1.5 * torch.randn(n, 3, generator=generator, dtype=torch.float64)
    aim[::4] = 0
    directions = torch.nn.functional.normalize(aim - origins, dim=-1)
    directions[1::7] = torch.tensor([0.0, 0.0, -1.0], dtype=torch.float64)  # along the poles
    return origins.to(dtype), directions.to(dtype)


@FUZZ
@given(
    seed=SEEDS,
    density=st.sampled_from([-100.0, -4.0, 0.0, 30.0, 1e4]),
    color=st.sampled_from([-50.0, 0.0, 9.0, 80.0]),
    spread=st.sampled_from([0.0, 1.0, 30.0]),
    distance=st.sampled_from([0.05, 0.6, 1.0, 2.5, 31.9, 100.0, 1e4]),
)
def test_extreme_environments_render_finitely_and_alike(seed, density, color, spread, distance):
    generator = torch.Generator().manual_seed(seed)
    noise = spread * torch.randn(4, 6, 12, 4, generator=generator, dtype=torch.float64)
    start = noise + torch.tensor([density, color, color, color], dtype=torch.float64)
    detail = spread * torch.randn(12, 24, 3, generator=generator, dtype=torch.float64)
    origins, directions = rays_from(distance, 24, seed, torch.float64)
    near = torch.full((24,), 0.6, dtype=torch.float64)
    far = torch.where(torch.arange(24) % 3 == 0, torch.inf, near + torch.arange(24) - 4.0)
    results = []
    for body in ("numba", "torch"):
        raw = start.clone().requires_grad_()
        shown = render_environment(
            raw,
            detail,
            RaySegments(origins, directions, near, far),
            EnvironmentVolume(
                contraction_radius=12.0,
                density_gain=16.0,
                longest_step=0.3,
                gradient_near=2.0,
                transmittance_limit=0.0,
                depth_limit=0.0,
            ),
            body=body,
        )
        sum(part.sum() for part in shown).backward()
        results.append((*(part.detach() for part in shown), raw.grad))
    for ours, reference in zip(*results, strict=True):
        assert torch.isfinite(ours).all() and torch.isfinite(reference).all()
        # rays through the center itself are bent by b >= 1e-3 in one body: 5e-7 of a radius, times the field's slope
        torch.testing.assert_close(ours, reference, rtol=1e-4, atol=1e-4 * max(1e-2, float(reference.abs().max())))
    assert (results[0][1] >= 0).all() and (results[0][1] <= 1 + 1e-12).all()


@FUZZ
@given(
    seed=SEEDS,
    density=st.sampled_from([-100.0, -4.0, 30.0, 1e4]),
    color=st.sampled_from([-50.0, 0.0, 80.0]),
    spread=st.sampled_from([0.0, 30.0]),
    angle=st.sampled_from([0.0, 1e-9, 0.01, 1.0, math.pi / 2]),
)
def test_cones_through_extreme_environments_are_finite(seed, density, color, spread, angle):
    field = EnvironmentField(EnvironmentPreset(resolutions=((4, 12), (4, 12)), refine_at=(2.0,)))
    generator = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        field.raw += spread * torch.randn(field.raw.shape, generator=generator)
        field.raw += torch.tensor([density, color, color, color]) - field.raw[0, 0, 0].clone()
    field.freeze(*rays_from(3.0, 50, seed))
    origins, directions = rays_from(0.999, 40, seed + 1)
    radiance, coverage = field.query_cone(origins, directions, angle)
    assert torch.isfinite(radiance).all() and (radiance >= 0).all() and radiance.max() < 1.01 * math.exp(9)
    assert (coverage >= 0).all() and (coverage <= 1).all()


@FUZZ
@given(seed=SEEDS, size=st.sampled_from([1e-30, 1e-3, 1.0, 1e8]), at=st.sampled_from([0.0, 1.0, -1.0, 0.5]))
def test_splines_of_any_size_agree_with_torch(seed, size, at):
    generator = torch.Generator().manual_seed(seed)
    start = size * torch.randn(6, 6, 6, generator=generator, dtype=torch.float64)
    points = torch.rand(30, 3, generator=generator, dtype=torch.float64) * 2 - 1
    points[:6] = at
    weight = torch.randn(30, 10, generator=generator, dtype=torch.float64)
    results = []
    for sample in (lambda c, p, hessian: bspline.Spline(c).sample(p, hessian), bspline.sample_torch):
        coefficients = start.clone().requires_grad_()
        out = sample(coefficients, points, hessian=True)
        (out * weight).sum().backward()
        results.append((out.detach() / size, coefficients.grad))
    for ours, reference in zip(*results, strict=True):
        torch.testing.assert_close(ours, reference, rtol=1e-9, atol=1e-9)


@FUZZ
@given(
    seed=SEEDS,
    sharpness=st.sampled_from([1e-3, 12.0, 400.0, 1e8]),
    size=st.sampled_from([0.0, 1e-6, 1.0, 1e6]),
    shift=st.sampled_from([-1e3, 0.0, 0.3, 1e3]),
    distance=st.sampled_from([0.5, 1.0, 2.5, 100.0, 1e4]),
)
def test_surfaces_of_extreme_fields_composite_finitely(seed, sharpness, size, shift, distance):
    generator = torch.Generator().manual_seed(seed)
    coefficients = (shift + size * torch.randn(10, 10, 10, generator=generator)).requires_grad_()
    origins, directions = rays_from(distance, 40, seed)
    found = render_surface(SplineShape(coefficients), origins, directions, sharpness, 8, torch.Generator().manual_seed(seed))
    for values in (found.opacity, found.point, found.gradient, found.eikonal, found.depth):
        assert torch.isfinite(values).all()
    assert (found.opacity >= 0).all() and (found.opacity <= 1 + 1e-5).all()
    total = found.opacity.sum() + (found.gradient / max(size, 1e-3)).sum()
    if total.requires_grad:
        total.backward()
        assert torch.isfinite(coefficients.grad).all()


@FUZZ
@given(distance=st.sampled_from([1.001, 2.5, 100.0, 1e3, 1e4]), seed=SEEDS)
def test_the_sphere_is_met_where_it_is_from_any_distance(distance, seed):
    """Against float64: the textbook's b^2 - c loses the sphere from afar, where b^2 is much larger than 1."""
    origins, directions = rays_from(distance, 200, seed)
    entry, leave = sphere_interval(origins, directions)
    o, d = origins.double(), directions.double()
    d = d / d.norm(dim=-1, keepdim=True)
    closest = o - (o * d).sum(-1, keepdim=True) * d
    chord = 2 * (1 - (closest**2).sum(-1)).clamp(min=0).sqrt()
    clear = (closest.norm(dim=-1) - 1).abs() > 1e-5 * distance  # at the very rim a float32 direction decides
    outside = -(o * d).sum(-1) > 0.5 * chord
    pick = clear & outside
    assert ((leave - entry)[pick] - chord[pick]).abs().max() < 1e-4 * max(1.0, 0.05 * distance)


@FUZZ
@given(
    seed=SEEDS,
    roughness=st.sampled_from([0.0, 0.02, 0.3, 1.0]),
    metallic=st.sampled_from([0.0, 1.0]),
    albedo=st.sampled_from([0.0, 0.5, 1.0]),
    cosine=st.sampled_from([1e-7, 1e-3, 0.5, 1.0]),
)
def test_the_brdf_is_finite_and_reflects_no_more_than_it_gets(seed, roughness, metallic, albedo, cosine):
    generator = torch.Generator().manual_seed(seed)
    n = 64
    v = torch.tensor([math.sqrt(1 - cosine**2), 0.0, cosine]).expand(n, 3)
    a, r, m = (
        torch.full((n, 3), albedo).requires_grad_(),
        torch.full((n,), roughness).requires_grad_(),
        torch.full((n,), metallic),
    )
    light, _ = brdf.sample_cosine(torch.rand(n, 2, generator=generator))
    value = brdf.evaluate(v, light, a, r, m)
    value.sum().backward()
    assert all(torch.isfinite(x).all() for x in (value, a.grad, r.grad)) and (value >= 0).all()
    turn = torch.rand(n, 2, generator=generator)
    direction, weight, cos_vh, angle = specular_cones(v, r.detach(), 4, turn)
    for values in (direction, weight, cos_vh, angle, *diffuse_cones(8, turn)):
        assert torch.isfinite(values).all()
    assert (weight >= 0).all() and weight.sum(-1).max() <= 1 + 1e-4 and angle.max() <= math.pi / 2


class RoughnessLevels:
    """The light of n samples at two roughness levels, as the fit of materials sees it."""

    def __init__(self, moments: torch.Tensor, diffuse: torch.Tensor, cos_v: torch.Tensor) -> None:
        self.specular, self.diffuse, self.cos_v = moments, diffuse, cos_v

    def roughness_interval(self, roughness: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        return torch.zeros_like(roughness, dtype=torch.int64), roughness

    def moments(self, roughness: torch.Tensor, rows) -> SpecularMoments:
        between = torch.lerp(self.specular[rows, 0], self.specular[rows, 1], roughness)
        return SpecularMoments(between[:, 0], between[:, 1], between[:, 2])


@settings(FUZZ, max_examples=12)
@given(
    seed=SEEDS,
    light=st.sampled_from([0.0, 1e-12, 1.0, 6e4]),
    target=st.sampled_from([0.0, 1.0, 6e4]),
    cosine=st.sampled_from([1e-6, 0.02, 1.0]),
)
def test_the_fit_of_materials_survives_any_light_and_any_photo(seed, light, target, cosine):
    generator = torch.Generator().manual_seed(seed)
    n = 12
    full = light * torch.rand(n, 2, 1, 3, generator=generator)
    moments = torch.cat([full, 0.3 * full, 0.05 * full], 2)
    roughness_levels = RoughnessLevels(moments, light * torch.rand(n, 3, generator=generator), torch.full((n,), cosine))
    photo = target * torch.rand(n, 3, generator=generator)
    group = torch.arange(n) % 4 - 1  # one in four in no group; group 3 stays empty
    weight = torch.rand(n, generator=generator)
    cost, albedo = fit_groups(roughness_levels, photo, weight, group, 4, least_roughness=0.02, clip=0.25)
    palette = best_of(cost, albedo, 0.02, (0.0, 1.0), 0.97)
    for values in (cost, albedo, palette.albedo, palette.roughness):
        assert torch.isfinite(values).all() and (values >= 0).all()
    assert palette.albedo.max() <= 1 and palette.roughness.max() <= 1.0001 and palette.roughness.min() >= 0.0199


@pytest.mark.parametrize("dtype", LOW, ids=str)
def test_kernels_take_low_precision_and_compute_in_float32(dtype):
    """Fields may be stored in 16 bits. The result is float32, and that of the same numbers given as float32."""
    generator = torch.Generator().manual_seed(0)
    coefficients = torch.randn(6, 6, 6, generator=generator).to(dtype).requires_grad_()
    points = (torch.rand(20, 3, generator=generator) * 2 - 1).to(dtype)
    finer = torch.randn(10, 10, 10, generator=generator).to(dtype)
    raw = torch.randn(4, 6, 12, 4, generator=generator).to(dtype).requires_grad_()
    origins, directions = (x.to(dtype) for x in rays_from(2.5, 20, 0))
    near, far = torch.full((20,), 0.5, dtype=dtype), torch.full((20,), math.inf, dtype=dtype)
    volume = EnvironmentVolume(contraction_radius=12.0, density_gain=2.0, longest_step=0.3)

    def all_of(c, finer, p, r, e, o, d, n, f):
        return [
            bspline.Spline(c).sample(p),
            bspline.refine(c),
            bspline.refine(c, finer),
            touched_mean_square(c),
            render_environment(r, e, RaySegments(o, d, n, f), volume)[0],
            total_variation(r, (1.0,) * 4, 0.1),
            *march(c, o, d, n, n + 4, 0.3, 0.1)[:1],
        ]

    detail = torch.randn(12, 24, 3, generator=generator).to(dtype)
    given_low = (coefficients, finer, points, raw, detail, origins, directions, near, far)
    for low, full in zip(all_of(*given_low), all_of(*(x.detach().float() for x in given_low)), strict=True):
        assert low.dtype == torch.float32
        torch.testing.assert_close(low.detach(), full, rtol=0, atol=0)
    sum(x.sum() for x in all_of(*given_low)[:6]).backward()
    assert coefficients.grad.dtype == dtype and torch.isfinite(coefficients.grad).all() and torch.isfinite(raw.grad).all()


def test_evidence_of_cameras_beyond_the_sky_ends():
    field = EnvironmentField(EnvironmentPreset(resolutions=((4, 12), (4, 12)), refine_at=(2.0,)))
    field.freeze(*rays_from(1e4, 30, 0))
    assert np.isfinite(field.coverage.numpy()).all()
