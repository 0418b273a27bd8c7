"""The optimizers: their steps against torch.optim and against the formula of AdamUniform, and their states."""

import subprocess
import sys

import pytest
import torch

from blender_nep.optimizers import Adam, UniformAdam


def _learn(optimizer, parameters, steps, seed):
    """Take steps with random gradients. The last parameter gets none in the first step."""
    generator = torch.Generator().manual_seed(seed)
    for step in range(steps):
        for parameter in parameters:
            parameter.grad = torch.randn(parameter.shape, generator=generator)
        if step == 0:
            parameters[-1].grad = None
        optimizer.step()


def _parameters():
    return [torch.nn.Parameter(torch.linspace(-1, 1, 12).reshape(3, 4)), torch.nn.Parameter(torch.ones(5))]


def test_adam_steps_as_that_of_torch():
    ours, theirs = _parameters(), _parameters()
    settings = {"lr": 0.03, "betas": (0.8, 0.95), "eps": 1e-5}
    for parameters, make in ((ours, Adam), (theirs, torch.optim.Adam)):
        groups = [{"params": parameters[:1], "lr": 0.01}, {"params": parameters[1:]}]
        _learn(make(groups, **settings), parameters, 4, seed=1)
    for own, other in zip(ours, theirs, strict=True):
        torch.testing.assert_close(own, other)


@pytest.mark.parametrize("make", [Adam, UniformAdam])
def test_an_optimizer_goes_on_from_its_state(make):
    whole, first, rest = _parameters(), _parameters(), _parameters()
    in_one = make(whole, lr=0.1)
    _learn(in_one, whole, 1, seed=1)
    _learn(in_one, whole, 2, seed=2)
    before = make(first, lr=0.1)
    _learn(before, first, 1, seed=1)
    after = make(rest, lr=0.1)
    for parameter, value in zip(rest, first, strict=True):
        parameter.data.copy_(value)
    after.load(before.state())
    _learn(after, rest, 2, seed=2)
    for own, other in zip(rest, whole, strict=True):
        assert torch.equal(own, other)


def test_a_step_of_adam_does_not_import_the_compiler_of_torch():
    """The first object of torch.optim.Optimizer imports it, which takes more than two CPU seconds."""
    program = (
        "import sys, torch; from blender_nep.optimizers import Adam; p = torch.ones(2, requires_grad=True);"
        "a = Adam([p]); p.sum().backward(); a.step(); a.zero_grad();"
        "print('torch._dynamo' in sys.modules, float(p.detach()[0]) < 1)"
    )
    told = subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True).stdout
    assert told.split() == ["False", "True"]


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
