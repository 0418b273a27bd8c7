"""The B-spline volume in bricks against the dense volume with the same coefficients."""

import pytest
import torch

from blender_nep.ops.object import bspline
from blender_nep.ops.object.bspline_bricks import BRICK, Bricks, bricks_along_axis, sample_bricks, sample_bricks_torch
from blender_nep.ops.object.bspline_march import march, march_torch

CELLS = 21


def dense(bricks: Bricks) -> torch.Tensor:
    """The coefficients [N, N, N] of the same spline; those of missing bricks are 0."""
    size = bricks.cells + 2
    whole = torch.zeros((BRICK * len(bricks.slot),) * 3, dtype=bricks.coefficients.dtype)
    for brick in (bricks.slot >= 0).nonzero():
        x, y, z = (BRICK * brick).tolist()
        whole[x : x + BRICK, y : y + BRICK, z : z + BRICK] = bricks.coefficients[bricks.slot[tuple(brick)]].detach()
    return whole[:size, :size, :size].contiguous()


@pytest.fixture
def bricks():
    generator = torch.Generator().manual_seed(0)
    count = bricks_along_axis(CELLS)
    chosen = torch.rand(count, count, count, generator=generator) < 0.4
    slot = torch.full((count,) * 3, -1, dtype=torch.int32)
    slot[chosen] = torch.randperm(int(chosen.sum()), generator=generator, dtype=torch.int32)
    coefficients = torch.randn(int(chosen.sum()), BRICK, BRICK, BRICK, dtype=torch.float64, generator=generator)
    return Bricks(slot, coefficients, CELLS)


@pytest.fixture
def points():
    points = torch.rand(400, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1)) * 2 - 1
    points[0], points[1] = 1.0, -1.0
    return points


@pytest.mark.parametrize("hessian", [False, True])
@pytest.mark.parametrize("body", [sample_bricks, sample_bricks_torch])
def test_both_bodies_agree_with_the_dense_volume(bricks, points, hessian, body):
    expected = bspline.sample_torch(dense(bricks), points, hessian)
    torch.testing.assert_close(body(bricks, points, hessian), expected, rtol=1e-10, atol=1e-10)
    assert (expected == 0).all(1).any() and (expected != 0).all(1).any()


@pytest.mark.parametrize("hessian", [False, True])
def test_gradcheck(bricks, points, hessian):
    few = points[:8]

    def sampled(coefficients):
        return sample_bricks(bricks._replace(coefficients=coefficients), few, hessian)

    assert torch.autograd.gradcheck(sampled, bricks.coefficients.clone().requires_grad_(), atol=1e-6)


def test_every_number_of_threads_gives_the_same_gradient(bricks, points):
    import numba

    before, gradients = numba.get_num_threads(), []
    try:
        for threads in range(1, before + 1):
            numba.set_num_threads(threads)
            coefficients = bricks.coefficients.clone().requires_grad_()
            sample_bricks(bricks._replace(coefficients=coefficients), points, True).square().sum().backward()
            gradients.append(coefficients.grad)
    finally:
        numba.set_num_threads(before)
    for gradient in gradients:
        torch.testing.assert_close(gradient, gradients[0])


@pytest.mark.parametrize("body", [march, march_torch])
def test_rays_stop_at_the_sum_of_a_dense_volume_and_bricks(bricks, body):
    x = (torch.arange(CELLS + 2) - 0.5) / CELLS * 2 - 1
    axes = torch.meshgrid(x, x, x, indexing="ij")
    ball = (axes[0] ** 2 + axes[1] ** 2 + axes[2] ** 2).sqrt() - 0.6
    fine = bricks._replace(coefficients=0.05 * bricks.coefficients.float())
    generator = torch.Generator().manual_seed(3)
    origins = torch.nn.functional.normalize(torch.randn(300, 3, generator=generator), dim=-1) * 3
    directions = torch.nn.functional.normalize(torch.randn(300, 3, generator=generator) * 0.35 - origins, dim=-1)
    near, far = torch.full((300,), 2.0), torch.full((300,), 4.0)
    arguments = (origins, directions, near, far, 0.03, 0.01)
    spans, count = body(ball, *arguments, fine=fine)
    expected_spans, expected_count = body(ball + dense(fine), *arguments)
    assert torch.equal(count, expected_count)
    torch.testing.assert_close(spans, expected_spans, rtol=0, atol=1e-4)
    assert not torch.allclose(spans, body(ball, *arguments)[0], atol=1e-2), "the bricks matter here"
