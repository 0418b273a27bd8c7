"""The SDF's optimizer: its step against the formula of AdamUniform."""

import torch

from blender_nep.fields.optimizer import UniformAdam


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
