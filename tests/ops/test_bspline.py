"""The quadratic B-spline volume against closed forms, its plain torch body and finite differences."""

import math

import pytest
import torch

from blender_nep.ops.object import bspline
from blender_nep.ops.object.bspline_march import march, march_torch


@pytest.fixture
def spline():
    generator = torch.Generator().manual_seed(1)
    coefficients = torch.randn(9, 9, 9, dtype=torch.float64, generator=generator)
    points = torch.rand(64, 3, dtype=torch.float64, generator=generator) * 2 - 1
    points[0], points[1] = 1.0, -1.0
    return coefficients, points


def greville(cells: int, function):
    """Coefficients from a function's values at the Greville points."""
    x = (torch.arange(cells + 2, dtype=torch.float64) - 0.5) / cells * 2 - 1
    return function(*torch.meshgrid(x, x, x, indexing="ij"))


def test_linear_functions_are_reproduced_exactly():
    coefficients = greville(7, lambda x, y, z: 0.3 * x - 2 * y + 0.7 * z + 0.1)
    points = torch.rand(100, 3, dtype=torch.float64) * 2 - 1
    out = bspline.Spline(coefficients).sample(points, hessian=True)
    expected = points @ torch.tensor([0.3, -2, 0.7], dtype=torch.float64) + 0.1
    torch.testing.assert_close(out[:, 0], expected)
    torch.testing.assert_close(out[:, 1:4], torch.tensor([[0.3, -2, 0.7]], dtype=torch.float64).expand(100, 3))
    assert out[:, 4:].abs().max() < 1e-10


def test_quadratic_function_has_its_hessian():
    # the Greville samples of x^2 give x^2 plus a constant: derivatives are exact
    coefficients = greville(8, lambda x, y, z: 1.5 * x * x - y * y + x * z)
    out = bspline.Spline(coefficients).sample(torch.tensor([[0.21, -0.4, 0.77]], dtype=torch.float64), hessian=True)[0]
    expected = [3 * 0.21 + 0.77, 0.8, 0.21, 3.0, -2.0, 0.0, 0.0, 1.0, 0.0]
    torch.testing.assert_close(out[1:], torch.tensor(expected, dtype=torch.float64))


def test_derivatives_against_finite_differences(spline):
    coefficients, points = spline
    points = points[2:] * 0.98
    out = bspline.Spline(coefficients).sample(points)
    for axis in range(3):
        shift = torch.zeros(3, dtype=torch.float64)
        shift[axis] = 1e-6
        difference = (
            bspline.Spline(coefficients).sample(points + shift)[:, 0]
            - bspline.Spline(coefficients).sample(points - shift)[:, 0]
        ) / 2e-6
        torch.testing.assert_close(out[:, 1 + axis], difference, atol=1e-6, rtol=1e-5)


@pytest.mark.parametrize("hessian", [False, True])
def test_compiled_and_torch_bodies_agree(spline, hessian):
    coefficients, points = spline
    torch.testing.assert_close(
        bspline.Spline(coefficients).sample(points, hessian), bspline.sample_torch(coefficients, points, hessian)
    )


@pytest.mark.parametrize("hessian", [False, True])
def test_gradcheck(spline, hessian):
    coefficients, points = spline
    assert torch.autograd.gradcheck(
        lambda c: bspline.Spline(c).sample(points[:12], hessian), coefficients.requires_grad_(), atol=1e-6
    )


def test_samples_of_a_step_add_to_one_gradient(spline):
    """Also in a second step, and if only one of the two samples counts."""
    coefficients, points = spline
    near, far = points[:20], points[5:40]
    spline = bspline.Spline(coefficients.requires_grad_())
    for second in (1.0, 0.0, 2.0):
        expected = coefficients.detach().clone().requires_grad_()
        reference = bspline.sample_torch(expected, near).square().sum()
        reference = reference + second * bspline.sample_torch(expected, far, True).square().sum()
        reference.backward()
        coefficients.grad = None
        loss = spline.sample(near).square().sum()
        if second:
            loss = loss + second * spline.sample(far, True).square().sum()
        loss.backward(retain_graph=True)
        torch.testing.assert_close(coefficients.grad, expected.grad)


def test_refinement_is_exact(spline):
    coefficients, points = spline
    fine = bspline.refine(coefficients)
    assert fine.shape == (16, 16, 16)
    torch.testing.assert_close(bspline.Spline(fine).sample(points), bspline.Spline(coefficients).sample(points))


def sphere_coefficients():
    """The SDF of a ball of radius 0.6."""
    return greville(48, lambda x, y, z: (x * x + y * y + z * z).sqrt() - 0.6).float()


def rays_at(distance, count, spread):
    """Rays from a sphere of that radius to places near the center, and where they enter and leave the unit sphere."""
    generator = torch.Generator().manual_seed(3)
    origins = torch.nn.functional.normalize(torch.randn(count, 3, generator=generator), dim=-1) * distance
    aim = torch.randn(count, 3, generator=generator) * spread
    directions = torch.nn.functional.normalize(aim - origins, dim=-1)
    along = -(origins * directions).sum(-1)
    root = (1 - ((origins * origins).sum(-1) - along**2)).clamp(min=0).sqrt()
    return origins, directions, along - root, along + root


@pytest.mark.parametrize("body", [march, march_torch])
def test_march_brackets_a_sphere(body):
    coefficients = sphere_coefficients()
    origins, directions, near, far = rays_at(3, 200, 0.35)
    band, step = 0.03, 0.01
    along = -(origins * directions).sum(-1)
    off_axis = ((origins * origins).sum(-1) - along**2).sqrt()
    spans, count = body(coefficients, origins, directions, near, far, band, step)
    hits, misses = off_axis < 0.55, off_axis > 0.65
    assert hits.any() and misses.any()
    assert (count[hits] == 1).all() and (count[misses] == 0).all()
    enters, leaves = (along[hits] - ((0.6 + side) ** 2 - off_axis[hits] ** 2).sqrt() for side in (band, -band))
    start, end = spans[hits, 0].unbind(-1)
    spline_error = 3e-3  # the spline is not quite a sphere
    assert (start < enters + spline_error).all() and (start > enters - step - spline_error).all()
    assert (end > leaves - spline_error).all() and (end < leaves + step + spline_error).all()


@pytest.mark.parametrize("body", [march, march_torch])
def test_a_ray_that_starts_inside_gets_a_span_there(body):
    generator = torch.Generator().manual_seed(5)
    directions = torch.nn.functional.normalize(torch.randn(20, 3, generator=generator), dim=-1)
    near, far = torch.full((20,), 0.1), torch.ones(20)
    spans, count = body(sphere_coefficients(), 0.1 * directions, directions, near, far, 0.03, 0.01)
    assert (count == 1).all() and torch.equal(spans[:, 0], torch.stack([near, near], -1))


@pytest.mark.parametrize("body", [march, march_torch])
def test_a_step_over_the_whole_band_gets_a_span(body):
    origins, directions, near, far = rays_at(3, 50, 0.2)
    along = -(origins * directions).sum(-1)
    surface = along - (0.36 - ((origins * origins).sum(-1) - along**2)).sqrt()
    spans, count = body(sphere_coefficients(), origins, directions, near, far, 0.002, 0.05)
    assert (count == 1).all()
    start, end = spans[:, 0].unbind(-1)
    assert (start < surface + 3e-3).all() and (end > surface - 3e-3).all() and (end - start < 0.11).all()


@pytest.mark.parametrize("body", [march, march_torch])
def test_no_rays_and_empty_intervals_have_no_spans(body):
    origins, directions, near, far = rays_at(3, 50, 0.2)
    for some, end in ((slice(0, 0), far), (slice(None), near), (slice(None), near - 1)):
        rays = [part[some] for part in (origins, directions, near, end)]
        spans, count = body(sphere_coefficients(), *rays, 0.03, 0.01)
        assert spans.shape == (len(rays[0]), 4, 2) and not count.any()


def test_the_torch_march_in_parts_is_the_march(monkeypatch):
    rays = rays_at(3, 50, 0.2)
    whole = march_torch(sphere_coefficients(), *rays, 0.03, 0.01)
    monkeypatch.setattr("blender_nep.ops.object.bspline_march._RAYS", 7)
    parts = march_torch(sphere_coefficients(), *rays, 0.03, 0.01)
    assert whole[1].any() and all(map(torch.equal, whole, parts))


def test_a_point_that_is_not_a_number_has_no_value():
    points = torch.tensor([[0.1, math.nan, 0.2], [0.1, 0.2, 0.3]])
    for sampled in (
        bspline.Spline(sphere_coefficients()).sample(points),
        bspline.sample_torch(sphere_coefficients(), points),
    ):
        assert sampled[0].isnan().all() and sampled[1].isfinite().all()


@pytest.mark.parametrize("body", [march, march_torch])
@pytest.mark.parametrize("most", [4, 1])
def test_spans_hold_all_of_the_band_before_the_inside(body, most):
    """Brute force on rays that pass by some balls before they enter another, or none."""
    balls = torch.tensor([[0.5, 0.1, 0.0], [-0.4, 0.3, 0.2], [0.0, -0.5, 0.3], [0.1, 0.2, -0.6]])

    def sdf(x, y, z):
        place = torch.stack([x, y, z], -1).float()
        return (place[..., None, :] - balls).norm(dim=-1).amin(-1) - 0.18

    coefficients = greville(64, sdf)
    origins, directions, near, far = rays_at(3, 400, 0.5)
    band, step = 0.08, 0.01
    spans, count = body(coefficients, origins, directions, near, far, band, step, most)
    t = near[:, None] + torch.arange(2200) * 0.001
    points = origins[:, None] + t[..., None] * directions[:, None]
    value = bspline.Spline(coefficients).sample(points.clamp(-1, 1).reshape(-1, 3))[:, 0].reshape(t.shape)
    deep = (value <= -band) | (t >= far[:, None])
    wanted = (value.abs() < band - 0.002) & (deep.cumsum(1) == 0)
    used = torch.arange(most) < count[:, None]
    held = ((t[..., None] >= spans[:, None, :, 0]) & (t[..., None] <= spans[:, None, :, 1]) & used[:, None]).any(-1)
    whole = count < most
    assert whole.any() and (count > 1).any() == (most == 4) and (~whole).any() == (most == 1)
    assert (held | ~wanted)[whole].all()
    last = torch.where(used, spans[..., 1], 0).amax(1)
    assert (held | ~wanted | (t > last[:, None]))[~whole].all()  # all up to the last span
    too_much = held & (value.abs() > band + 1.5 * step)
    assert not too_much.any()


def test_refinement_bodies_agree_and_pass_gradcheck():
    coefficients = torch.randn(6, 7, 5, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    coefficients.requires_grad_()
    torch.testing.assert_close(bspline.refine(coefficients), bspline.refine_torch(coefficients), rtol=1e-12, atol=1e-12)
    assert torch.autograd.gradcheck(bspline.refine, (coefficients,))
    level = torch.randn(10, 12, 8, dtype=torch.float64, generator=torch.Generator().manual_seed(1)).requires_grad_()
    expected = bspline.refine_torch(coefficients) + level
    torch.testing.assert_close(bspline.refine(coefficients, level), expected, rtol=1e-12, atol=1e-12)
    assert torch.autograd.gradcheck(bspline.refine, (coefficients, level))
    for wrong in (torch.zeros(10, 12, 9, dtype=torch.float64), torch.zeros(0, 0, 0, dtype=torch.float64), level.float()):
        with pytest.raises(ValueError, match="a level must be"):
            bspline.refine(coefficients, wrong)
