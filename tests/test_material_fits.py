"""Fits of albedos to groups of photo samples: the two ways to compute them against each other and against the truth."""

import numpy as np
import pytest
import torch

from blender_nep import material_fits
from blender_nep.material_fits import fit_groups, roughness_scan
from blender_nep.shading.incoming_light import IncomingLight
from blender_nep.shading.plenoptic import Material, SpecularMoments, reflected

RUNGS = torch.tensor([0.05, 0.15, 0.3, 0.6, 1.0])


class Lit:
    """The light of n samples on a ladder of roughnesses: random, but smooth along the ladder."""

    rung, moments = IncomingLight.rung, IncomingLight.moments

    def __init__(self, n: int) -> None:
        generator = torch.Generator().manual_seed(3)
        ends = torch.rand(n, 2, 3, generator=generator) * 3
        full = torch.lerp(ends[:, :1], ends[:, 1:], (len(RUNGS) - 1 - torch.arange(len(RUNGS))[None, :, None]) / 4.0)
        self.ladder, self.specular = RUNGS, torch.stack([full, 0.15 * full, 0.06 * full], 2)
        self.diffuse, self.cos_v = torch.rand(n, 3, generator=generator), 0.3 + 0.7 * torch.rand(n, generator=generator)


def fitted(way, light, target, weight, group, groups):
    member = (group >= 0).nonzero().squeeze(-1)
    return way(light, target, weight, group, groups, member, roughness_scan(0.05, target.device), 0.25, (0.0, 0.3, 1.0), 2.5)


@pytest.mark.parametrize("groups", [1, 5])
def test_the_kernel_fits_what_torch_fits(groups):
    n, generator = 900, torch.Generator().manual_seed(groups)
    light = Lit(n)
    target = 2 * torch.rand(n, 3, generator=generator) * light.specular[:, 2, 0]
    weight, group = torch.rand(n, generator=generator), torch.randint(-1, groups, (n,), generator=generator)
    group[group == 3] = -1  # a group of none
    fused, batched = (fitted(way, light, target, weight, group, groups)
                      for way in (material_fits._fit_fused, material_fits._fit_batched))
    for ours, theirs in zip(fused, batched, strict=True):
        torch.testing.assert_close(ours, theirs, rtol=1e-3, atol=2e-4)


@pytest.mark.parametrize("metallic", [0.0, 1.0])
def test_the_material_that_made_the_photo_is_the_best_of_all(metallic):
    n = 400
    light, scan = Lit(n), roughness_scan(0.05, torch.device("cpu"))
    albedo, j = torch.tensor([0.7, 0.4, 0.2]), 11
    material = Material(albedo.expand(n, 3), scan[j].expand(n), torch.full((n,), metallic))
    assert isinstance(light.moments(scan[j]), SpecularMoments)
    photo = reflected(material, light.moments(scan[j].expand(n)), light.diffuse, light.cos_v)
    group = torch.zeros(n, dtype=torch.int64)
    cost, found = fit_groups(light, photo, torch.ones(n), group, 1, least_roughness=0.05, clip=0.25)
    assert np.unravel_index(cost.argmin(), cost.shape)[:2] == (int(metallic), j)
    assert cost.min() < 1e-4
    torch.testing.assert_close(found[int(metallic), j, 0], albedo, rtol=0, atol=1e-3)


def test_no_sample_is_no_material():
    nothing = torch.zeros(0)
    light = Lit(0)
    cost, albedo = fit_groups(light, torch.zeros(0, 3), nothing, nothing.long(), 2, least_roughness=0.05, clip=0.25)
    assert (cost == 0).all() and (albedo == 0).all()
