"""The SDF's optimizer: its mean square against plain torch, and its step against the formula of AdamUniform."""

import pytest
import torch

from blender_nep.fields.optimizer import UniformAdam
from blender_nep.ops.touched import _PART, touched_mean_square


@pytest.mark.parametrize("n", [1, 1000, _PART, 3 * _PART + 5])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64], ids=str)
def test_mean_square_is_that_of_the_touched_entries(n, dtype):
    gradient = torch.randn(n, generator=torch.Generator().manual_seed(n)).to(dtype)
    gradient[torch.rand(n, generator=torch.Generator().manual_seed(1)) < 0.8] = 0
    touched = gradient[gradient != 0]
    expected = touched.square().mean() if len(touched) else gradient.new_zeros(())
    torch.testing.assert_close(touched_mean_square(gradient), expected, rtol=1e-5, atol=0)


def test_mean_square_of_an_untouched_gradient_and_of_one_that_is_not_contiguous():
    assert touched_mean_square(torch.zeros(7)) == 0
    assert touched_mean_square(torch.tensor([[3.0, 0.0], [0.0, 5.0], [2.0, 0.0]]).T) == pytest.approx((9 + 25 + 4) / 3)


def test_a_step_is_that_of_uniform_adam():
    """Two steps on two levels, of which one has a scale, against the formula in float64."""
    generator = torch.Generator().manual_seed(0)
    levels = [torch.nn.Parameter(torch.randn(4, 4, 4, generator=generator)) for _ in range(2)]
    optimizer = UniformAdam([{"params": [levels[0]]}, {"params": [levels[1]], "scale": 0.5}], lr=0.1, betas=(0.8, 0.95))
    expected = [(level.detach().double().clone(), 0.0, 0.0) for level in levels]
    for step in (1, 2):
        gradients = [torch.randn(4, 4, 4, generator=generator) for _ in levels]
        for i, (level, gradient) in enumerate(zip(levels, gradients, strict=True)):
            gradient[0] = 0
            level.grad = gradient
            value, mean, square = expected[i]
            mean = 0.8 * mean + 0.2 * gradient.double()
            square = 0.95 * square + 0.05 * gradient.double().square().sum() / 48
            rate = 0.1 * (1.0, 0.5)[i] / (1 - 0.8**step) / (square / (1 - 0.95**step)).sqrt()
            expected[i] = value - rate * mean, mean, square
        optimizer.step()
    for level, (value, _, _) in zip(levels, expected, strict=True):
        torch.testing.assert_close(level.detach().double(), value, rtol=1e-5, atol=1e-6)
