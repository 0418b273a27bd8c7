"""The quadratic B-spline volume against closed forms, its plain torch body and finite differences."""

import pytest
import torch

from blender_nep.ops import bspline
from blender_nep.ops.bspline_march import march, march_torch


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
    out = bspline.sample(coefficients, points, hessian=True)
    expected = points @ torch.tensor([0.3, -2, 0.7], dtype=torch.float64) + 0.1
    torch.testing.assert_close(out[:, 0], expected)
    torch.testing.assert_close(out[:, 1:4], torch.tensor([[0.3, -2, 0.7]], dtype=torch.float64).expand(100, 3))
    assert out[:, 4:].abs().max() < 1e-10


def test_quadratic_function_has_its_hessian():
    # the Greville samples of x^2 give x^2 plus a constant: derivatives are exact
    coefficients = greville(8, lambda x, y, z: 1.5 * x * x - y * y + x * z)
    out = bspline.sample(coefficients, torch.tensor([[0.21, -0.4, 0.77]], dtype=torch.float64), hessian=True)[0]
    expected = [3 * 0.21 + 0.77, 0.8, 0.21, 3.0, -2.0, 0.0, 0.0, 1.0, 0.0]
    torch.testing.assert_close(out[1:], torch.tensor(expected, dtype=torch.float64))


def test_derivatives_against_finite_differences(spline):
    coefficients, points = spline
    points = points[2:] * 0.98
    out = bspline.sample(coefficients, points)
    for axis in range(3):
        shift = torch.zeros(3, dtype=torch.float64)
        shift[axis] = 1e-6
        difference = (
            bspline.sample(coefficients, points + shift)[:, 0] - bspline.sample(coefficients, points - shift)[:, 0]
        ) / 2e-6
        torch.testing.assert_close(out[:, 1 + axis], difference, atol=1e-6, rtol=1e-5)


@pytest.mark.parametrize("hessian", [False, True])
def test_compiled_and_torch_bodies_agree(spline, hessian):
    coefficients, points = spline
    torch.testing.assert_close(
        bspline.sample(coefficients, points, hessian), bspline.sample_torch(coefficients, points, hessian)
    )


@pytest.mark.parametrize("hessian", [False, True])
def test_gradcheck(spline, hessian):
    coefficients, points = spline
    assert torch.autograd.gradcheck(
        lambda c: bspline.sample(c, points[:12], hessian), coefficients.requires_grad_(), atol=1e-6
    )


def test_refinement_is_exact(spline):
    coefficients, points = spline
    fine = bspline.refine(coefficients)
    assert fine.shape == (16, 16, 16)
    torch.testing.assert_close(bspline.sample(fine, points), bspline.sample(coefficients, points))


def test_march_brackets_a_sphere():
    coefficients = greville(48, lambda x, y, z: (x * x + y * y + z * z).sqrt() - 0.6).float()
    generator = torch.Generator().manual_seed(3)
    origins = torch.nn.functional.normalize(torch.randn(200, 3, generator=generator), dim=-1) * 3
    directions = torch.nn.functional.normalize(torch.randn(200, 3, generator=generator) * 0.35 - origins, dim=-1)
    band, step = 0.03, 0.01
    b = (origins * directions).sum(-1)
    off_axis = ((origins * origins).sum(-1) - b * b).sqrt()
    near, far = -b - (1 - off_axis**2).clamp(min=0).sqrt(), -b + (1 - off_axis**2).clamp(min=0).sqrt()
    spans, count = march(coefficients, origins, directions, near, far, band, step)
    hits, misses = off_axis < 0.55, off_axis > 0.65
    assert hits.any() and misses.any()
    assert (count[hits] == 1).all() and (count[misses] == 0).all()
    surface = -b[hits] - (0.36 - off_axis[hits] ** 2).sqrt()
    assert (spans[hits, 0, 0] < surface).all() and (spans[hits, 0, 1] > surface).all()
    torch_spans, torch_count = march_torch(coefficients, origins, directions, near, far, band, step, 4)
    assert torch.equal(torch_count, count)
    torch.testing.assert_close(torch_spans, spans, atol=2e-3, rtol=0)


def test_refinement_bodies_agree_and_pass_gradcheck():
    coefficients = torch.randn(6, 7, 5, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    coefficients.requires_grad_()
    torch.testing.assert_close(bspline.refine(coefficients), bspline.refine_torch(coefficients), rtol=1e-12, atol=1e-12)
    assert torch.autograd.gradcheck(bspline.refine, (coefficients,))
