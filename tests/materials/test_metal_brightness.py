"""How bright metals are likely to be. What that does to a metal's light is tested in tests/shading/test_unseen_light.py."""

import numpy as np
import pytest
import torch

from blender_nep.materials.metal_brightness import (
    COLORED,
    DARK_COST,
    DARKEST,
    GRAY,
    brightened,
    cost_of_darkness,
    likely_brightness,
    missing_brightness,
)

IRON, SILVER, GOLD, COPPER = (0.56, 0.57, 0.58), (0.97, 0.96, 0.91), (1.0, 0.77, 0.34), (0.95, 0.64, 0.54)


@pytest.mark.parametrize("albedo", [IRON, SILVER, GOLD, COPPER])
def test_no_real_metal_is_too_dark(albedo):
    assert missing_brightness(torch.tensor([albedo]), torch.ones(1)).tolist() == [0]


def test_what_is_missing_is_a_logarithm_and_only_of_metals():
    dark = torch.tensor([GOLD, IRON, GOLD]) * torch.tensor([[0.3], [0.4], [0.3]])
    missing = missing_brightness(dark, torch.tensor([1.0, 1.0, 0.0]))
    expected = torch.tensor([COLORED / 0.3, GRAY / (0.4 * 0.58), 1.0]).log()
    torch.testing.assert_close(missing, expected, rtol=0.15, atol=1e-6)
    assert missing[2] == 0
    assert likely_brightness(dark).tolist() == pytest.approx([COLORED, GRAY, COLORED], abs=0.03)


def test_metals_become_brighter_by_one_factor_and_keep_their_hue():
    albedo = torch.tensor([[0.4, 0.3, 0.1], [0.2, 0.2, 0.2], [0.4, 0.3, 0.1]])
    metallic = torch.tensor([1.0, 1.0, 0.0])
    torch.testing.assert_close(brightened(albedo, metallic, 2.0), albedo * torch.tensor([[2.0], [2.0], [1.0]]))
    far = brightened(albedo, metallic, 10.0)
    assert far.amax(-1).tolist() == pytest.approx([0.98, 0.98, 0.4])
    torch.testing.assert_close(far[0] / far[0, 0], albedo[0] / albedo[0, 0])


def test_a_black_albedo_is_finite():
    black = torch.zeros(1, 3)
    assert torch.isfinite(missing_brightness(black, torch.ones(1))).all()
    assert torch.isfinite(brightened(black, torch.ones(1), 4.0)).all()


@pytest.mark.parametrize(
    ("albedo", "share"),
    [
        ([0.2, 0.19, 0.12], COLORED * DARKEST / 0.2),  # tarnished brass: 1 % more
        ([GRAY * DARKEST, GRAY * DARKEST, GRAY * DARKEST], 1.0),
        ([0.055, 0.055, 0.055], 2.5),  # as dark as the coat of a black paint
        ([0.0, 0.0, 0.0], None),
    ],
)
def test_a_metal_costs_more_the_darker_it_is(albedo, share):
    """share: the brightness from which on darkness costs nothing, divided by that of the metal."""
    cost = cost_of_darkness(torch.tensor([albedo, albedo]), torch.tensor([1.0, 0.0]))
    assert cost[1] == 1, "a dielectric may be dark"
    assert cost[0] == pytest.approx(1 + DARK_COST * np.log(share), abs=0.01) if share else 2 < cost[0] < 5
