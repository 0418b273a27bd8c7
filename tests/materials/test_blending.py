"""Shares of two materials at a place, from residuals that are known in closed form."""

import numpy as np
import pytest
import torch

from blender_nep.materials.labels.blending import BlendedPoints, find_blends
from blender_nep.materials.palette.palette import Palette

MARGIN = 0.05


def palette(n):
    random = torch.Generator().manual_seed(3)
    return Palette(torch.rand(n, 3, generator=random), torch.rand(n, generator=random), torch.arange(n) % 2.0)


def residuals(blends, true):
    """Squared distance of every material and blend from the true [n, 5] albedo, roughness and metallic; blends cost more."""
    values = torch.cat([blends.albedo, blends.roughness[:, None], blends.metallic[:, None]], 1)
    cost = 0.01 + ((torch.from_numpy(true)[:, None] - values) ** 2).sum(-1)
    return (cost * torch.where(blends.blended, 1 + MARGIN, 1.0)).numpy()


def mixed(p, i, j, share):
    values = torch.cat([p.albedo, p.roughness[:, None], p.metallic[:, None]], 1).numpy()
    return (1 - share[:, None]) * values[i] + share[:, None] * values[j]


def blends(cost, p):
    """The materials that residuals `cost` [n, K + blends] lead to. Position, photo and residual do not matter here."""
    none = np.zeros(len(cost))
    return BlendedPoints(none, none, none, none, *find_blends(cost, p, MARGIN)).labeled(p)


@pytest.mark.parametrize(("materials", "pair"), [(2, (0, 1)), (3, (0, 2)), (3, (1, 2)), (4, (2, 3))])
def test_every_share_is_found_exactly(materials, pair):
    p = palette(materials)
    true = mixed(p, *pair, np.linspace(0, 1, 41))
    found = blends(residuals(p.with_blends(), true), p.with_blends())
    assert found.albedo == pytest.approx(true[:, :3], abs=1e-3)
    assert found.roughness == pytest.approx(true[:, 3], abs=1e-3)
    assert found.metallic == pytest.approx(true[:, 4], abs=1e-3)


def test_one_material_stays_as_it_is():
    p = palette(1)
    found = blends(np.ones((5, 1), np.float32), p)
    assert np.array_equal(found.albedo, p.albedo.expand(5, 3)) and np.array_equal(found.roughness, p.roughness.expand(5))


def test_materials_that_are_not_blended_stay_as_they_are():
    p = palette(6)
    values = torch.cat([p.albedo, p.roughness[:, None], p.metallic[:, None]], 1).numpy()
    found = blends(residuals(p.with_blends(), values), p.with_blends())
    assert found.albedo[4:] == pytest.approx(values[4:, :3], abs=1e-6)
    assert found.metallic == pytest.approx(values[:, 4], abs=1e-3)
