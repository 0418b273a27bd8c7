"""The hue of what differs between photos tells metal from dielectric, wherever the reflections lie."""

import numpy as np
import pytest
import torch

from blender_nep.materials.evidence.hue import evidence_of_metal, places
from blender_nep.shading.light_moments import LightMoments
from blender_nep.shading.plenoptic import Material, reflected

PLACES, PHOTOS = 40, 20
N = PLACES * PHOTOS
GOLD = torch.tensor([0.9, 0.62, 0.3])


def light(seed: int, color: torch.Tensor, count: int = N) -> LightMoments:
    """A random reflection of light of this color for every sample, and a diffuse light that is the same in all photos."""
    generator = torch.Generator().manual_seed(seed)
    full = torch.exp(torch.randn(count, 1, 1, generator=generator)) * color
    specular = torch.stack([full, 0.1 * full, 0.06 * full], 2).expand(-1, 3, -1, -1).contiguous()
    diffuse = torch.exp(0.3 * torch.randn(-(-count // PHOTOS), 1, generator=generator)).repeat_interleave(PHOTOS, 0)[:count]
    coverage, cos_v = torch.ones(count, 3), torch.full((count,), 0.8)
    return LightMoments(specular, diffuse * color, coverage, cos_v, torch.tensor([0.1, 0.3, 1.0]))


def photos(albedo: torch.Tensor, metallic: float, color: torch.Tensor, count: int = N) -> torch.Tensor:
    """What photos show of one material; their reflections lie elsewhere than those of `light(0, ...)`."""
    real, one = light(1, color, count), torch.ones(count)
    material = Material(albedo.expand(count, 3), 0.3 * one, metallic * one)
    return reflected(material, real.moments(material.roughness), real.diffuse, real.cos_v)


def said(target: torch.Tensor, color: torch.Tensor, group: torch.Tensor, groups: int = 1) -> list[float]:
    place = np.arange(len(target)) // PHOTOS
    return evidence_of_metal(light(0, color, len(target)), target, place, group, groups).tolist()


@pytest.mark.parametrize("color", [(1.0, 1.0, 1.0), (1.0, 0.7, 0.4), (0.5, 0.8, 1.0)], ids=["white", "warm", "cold"])
def test_metal_and_paint_of_a_color_are_told_apart_in_any_light(color):
    color, group = torch.tensor(color), torch.zeros(N, dtype=torch.int64)
    assert said(photos(GOLD, 1.0, color), color, group) == [1.0]
    assert said(photos(GOLD, 0.0, color), color, group) == [-1.0]


def test_gray_says_nothing_nor_do_few_places():
    white, group = torch.ones(3), torch.zeros(N, dtype=torch.int64)
    gray = torch.tensor([0.7, 0.68, 0.66])
    for metallic in (0.0, 1.0):
        assert abs(said(photos(gray, metallic, white), white, group)[0]) < 0.1
    few = 14 * PHOTOS
    assert said(photos(GOLD, 1.0, white, few), white, group[:few]) == [0.0]
    alone = np.arange(N)  # a place of one sample
    assert evidence_of_metal(light(0, white), photos(GOLD, 1.0, white), alone, group, 1).tolist() == [0.0]


def test_differences_as_of_a_wrong_shape_do_not_say_metal():
    white, group = torch.ones(3), torch.zeros(N, dtype=torch.int64)
    generator = torch.Generator().manual_seed(2)
    dull = GOLD * torch.exp(0.2 * torch.randn(N, 1, generator=generator))
    assert said(dull, white, group) == [0.0]
    assert said(GOLD + 0.2 * GOLD.mean() * torch.randn(N, 1, generator=generator), white, group) == [-1.0]


def test_groups_speak_for_themselves_and_loose_samples_for_none():
    white, one = torch.ones(3), torch.ones(N)
    half = torch.arange(N) // PHOTOS % 2
    target = torch.where(half[:, None] == 0, photos(GOLD, 1.0, white), photos(GOLD, 0.0, white))
    assert said(target, white, half, 3) == [1.0, -1.0, 0.0]
    assert said(torch.where(half[:, None] == 0, target, 1e4 * one[:, None]), white, torch.where(half == 0, 0, -1)) == [1.0]


def test_places_are_near_and_face_one_way():
    position = np.array([[0.01, 0.01, 0.01], [0.02, 0.03, 0.04], [0.01, 0.01, 0.01], [0.3, 0.01, 0.01]])
    normal = np.array([[0, 0, 1.0], [0.1, 0, 0.99], [0, 0, -1.0], [0, 0, 1.0]])
    a, b, c, d = places(position, normal)
    assert a == b and len({a, c, d}) == 3
