"""The mean of the irradiance over neighbors: against a search of all pairs, and against a lamp of known irradiance."""

import numpy as np
import pytest
import torch

from blender_nep.shading.smooth_irradiance import IrradianceMean


def sphere(n: int, radius: float = 0.5) -> tuple[torch.Tensor, torch.Tensor]:
    normal = torch.nn.functional.normalize(torch.randn(n, 3, generator=torch.Generator().manual_seed(4)), dim=-1)
    return radius * normal, normal


def test_it_is_the_mean_of_the_nearest_that_are_in_reach():
    position, normal = sphere(3000)
    values = torch.rand(3000, 3, generator=torch.Generator().manual_seed(5))
    distance = ((position[:, None] - position).square().sum(-1) + 0.04 * (normal[:, None] - normal).square().sum(-1)).sqrt()
    expected = torch.stack(
        [values[row.argsort()[:16][row.sort()[0][:16] <= 0.05]].mean(0) for row in distance]  # pairs of all points
    )
    torch.testing.assert_close(IrradianceMean(position, normal)(values), expected, rtol=0, atol=1e-5)


def test_a_lamps_noisy_irradiance_comes_nearer_to_the_truth():
    position, normal = sphere(20_000)
    truth = (normal @ torch.tensor([0.6, 0.0, 0.8])).clamp_min(0)[:, None].expand(-1, 3)  # a lamp at infinity: n.l
    noise = 0.1 * torch.randn(20_000, 3, generator=torch.Generator().manual_seed(6))
    mean = IrradianceMean(position, normal)(truth + noise)
    assert (mean - truth).square().mean().sqrt() < 0.35 * noise.square().mean().sqrt(), "16 values: a quarter at best"
    assert (mean - truth).mean().abs() < 2e-3


def test_two_sides_of_a_thin_sheet_do_not_mix():
    position = torch.rand(400, 3, generator=torch.Generator().manual_seed(7)) * torch.tensor([0.1, 0.1, 0.0])
    normal = torch.tensor([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]).repeat(200, 1)
    lit = normal[:, 2:].clamp_min(0).expand(-1, 3)
    assert torch.equal(IrradianceMean(position, normal)(lit) > 0.5, lit > 0.5)


@pytest.mark.parametrize("n", [0, 1, 3])
def test_few_points_far_apart_keep_their_values(n):
    position, normal = torch.eye(3)[:n], torch.eye(3)[:n]
    values = torch.from_numpy(np.arange(3.0 * n, dtype=np.float32).reshape(n, 3))
    torch.testing.assert_close(IrradianceMean(position, normal)(values), values)
