"""Fits of albedos to groups of photo samples: the kernel against torch in float64 and against the truth."""

from dataclasses import replace

import numba
import numpy as np
import pytest
import torch

from blender_nep.materials.fitting import fit_groups, roughness_scan, weight_of_found_light, weight_of_known_light
from blender_nep.shading.light_moments import LightMoments
from blender_nep.shading.plenoptic import Material, SpecularMoments, affine_in_albedo, reflected
from blender_nep.tone_mapping import tone_map

CLIP, LEAST, MOST_DIFFUSE = 0.25, 0.05, 2.5


def lit(n: int) -> LightMoments:
    """The light of n samples at several roughness levels: random, but smooth from level to level."""
    generator = torch.Generator().manual_seed(3)
    ends = 0.5 + torch.rand(n, 2, 3, generator=generator)
    full = torch.lerp(ends[:, :1], ends[:, 1:], torch.linspace(1, 0, 5)[None, :, None])
    specular = torch.stack([full, 0.15 * full, 0.06 * full], 2)
    diffuse = 0.3 + torch.rand(n, 3, generator=generator)
    cos_v = 0.3 + 0.7 * torch.rand(n, generator=generator)
    return LightMoments(specular, diffuse, torch.ones(n, 5), cos_v, torch.tensor([0.05, 0.15, 0.3, 0.6, 1.0]))


def by_torch(
    light: LightMoments, target: torch.Tensor, weight: torch.Tensor, metallic: float, j: int
) -> tuple[float, torch.Tensor]:
    """Cost and albedo of all samples, at the j-th roughness: reweighted least squares, all at once."""
    n, a = len(target), torch.full((3,), 0.5, dtype=torch.float64)
    r = roughness_scan(LEAST, target.device)[j].expand(n)
    moments = SpecularMoments(*(x.double() for x in vars(light.moments(r)).values()))
    for k in range(5):
        own = Material(a.expand(n, 3), r.double(), torch.full((n,), metallic, dtype=torch.float64))
        offset, slope = affine_in_albedo(own, moments, light.diffuse.double(), light.cos_v.double())
        predicted = offset + slope * a
        residual = tone_map(predicted) - tone_map(target.double())
        if k == 4:
            break
        mean = 0.5 * (predicted + target) if k else target.double()
        robust = weight[:, None] / (1 + 4 * mean) ** 2
        if k:
            robust = robust * (residual.abs() < 2 * CLIP) / residual.abs().clamp_min(0.02)
        instrument = metallic * mean + (1 - metallic) * slope
        a = (robust * instrument * (target - offset)).sum(0) / (robust * instrument * slope).sum(0).clamp_min(1e-12)
        a = a.clamp(0, 1 if metallic > 0.5 else MOST_DIFFUSE)
    return float((residual.abs().mean(-1).clamp_max(CLIP) * weight).sum() / weight.sum()), a


def photos(light: LightMoments) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Target, weight and group: of four groups 1 is too bright for any metal, 2 is empty, 3 has one color black; a sixth of
    the samples is in none."""
    n, generator = len(light.cos_v), torch.Generator().manual_seed(8)
    group = torch.randint(-1, 5, (n,), generator=generator)
    group[group == 2] = 0
    group[group == 4] = 3
    target = light.specular[:, 2, 0] * (0.4 + 0.2 * torch.rand(n, 3, generator=generator))
    target[group == 1] *= 3
    target[group == 3, 2] = 0
    return target, 0.1 + torch.rand(n, generator=generator), group


def test_the_kernel_fits_what_torch_fits():
    light = lit(900)
    target, weight, group = photos(light)
    hypotheses = (0.0, 0.3, 1.0)
    cost, albedo = fit_groups(
        light, target, weight, group, 4, least_roughness=LEAST, clip=CLIP, hypotheses=hypotheses, most_diffuse=MOST_DIFFUSE
    )
    for g in (0, 1, 3):
        rows = (group == g).nonzero().squeeze(-1)
        part = replace(light, specular=light.specular[rows], diffuse=light.diffuse[rows], cos_v=light.cos_v[rows])
        for i, metallic in enumerate(hypotheses):
            for j in (0, 9, 20, cost.shape[1] - 1):
                expected, a = by_torch(part, target[rows], weight[rows], metallic, j)
                assert float(cost[i, j, g]) == pytest.approx(expected, abs=2e-5)
                torch.testing.assert_close(albedo[i, j, g].double(), a, rtol=0, atol=1e-4)
    assert (cost[:, :, 2] == 0).all() and (albedo[:, :, 2] == 0).all()
    assert (albedo[2, :, 1] == 1).any() and (albedo[0, :, 1] > 1).any(), "the limits are met"
    assert (cost[:, :, 0] < 0.7 * CLIP).all(), "much is not clipped there"


def test_the_number_of_threads_does_not_matter():
    light = lit(900)
    target, weight, group = photos(light)
    found, threads = [], numba.get_num_threads()
    try:
        for count in (1, 4):
            numba.set_num_threads(count)
            found.append(fit_groups(light, target, weight, group, 4, least_roughness=LEAST, clip=CLIP))
    finally:
        numba.set_num_threads(threads)
    assert all(torch.equal(a, b) for a, b in zip(found[0], found[-1], strict=True))


@pytest.mark.parametrize("metallic", [0.0, 1.0])
def test_the_material_that_made_the_photo_is_the_best_of_all(metallic):
    n = 400
    light, scan = lit(n), roughness_scan(LEAST, torch.device("cpu"))
    albedo, j = torch.tensor([0.7, 0.4, 0.2]), 11
    material = Material(albedo.expand(n, 3), scan[j].expand(n), torch.full((n,), metallic))
    photo = reflected(material, light.moments(scan[j].expand(n)), light.diffuse, light.cos_v)
    group = torch.zeros(n, dtype=torch.int64)
    cost, found = fit_groups(light, photo, torch.ones(n), group, 1, least_roughness=LEAST, clip=CLIP)
    assert np.unravel_index(cost.argmin(), cost.shape)[:2] == (int(metallic), j)
    assert cost.min() < 1e-4
    torch.testing.assert_close(found[int(metallic), j, 0], albedo, rtol=0, atol=1e-3)


def test_no_sample_is_no_material():
    nothing = torch.zeros(0)
    cost, albedo = fit_groups(lit(0), torch.zeros(0, 3), nothing, nothing.long(), 2, least_roughness=LEAST, clip=CLIP)
    assert (cost == 0).all() and (albedo == 0).all()


def test_a_metal_with_misplaced_reflections_keeps_its_brightness():
    """The light of the photo and the known light differ by errors of one kind: each is the other's, misplaced.

    Least squares would give 0.53 for an albedo of 0.8.
    """
    n, generator = 4000, torch.Generator().manual_seed(5)
    light = lit(n)
    scene = torch.exp(0.8 * torch.randn(n, 1, 1, 1, generator=generator))
    known, shown = (scene * torch.exp(0.5 * torch.randn(n, 1, 1, 1, generator=generator)) for _ in range(2))
    albedo, ones = torch.tensor([0.8, 0.6, 0.3]), torch.ones(1, 5, 3, 3) * torch.tensor([1.0, 0.05, 0.04])[:, None]
    light = replace(light, specular=shown * ones)
    rough = torch.full((n,), 0.3)
    material = Material(albedo.expand(n, 3), rough, torch.ones(n))
    photo = reflected(material, light.moments(rough), light.diffuse, light.cos_v)
    light = replace(light, specular=known * ones)
    group = torch.zeros(n, dtype=torch.int64)
    _, found = fit_groups(light, photo, torch.ones(n), group, 1, least_roughness=LEAST, clip=10.0, hypotheses=(1.0,))
    j = int((roughness_scan(LEAST, torch.device("cpu")) - 0.3).abs().argmin())
    torch.testing.assert_close(found[0, j, 0], albedo, rtol=0.04, atol=0.01)


def test_samples_count_alike_where_photos_show_little_light():
    """After a walk the photos show most of the light, on a turntable a tenth, and cut-outs show none."""
    share = torch.linspace(0, 1, 20)[:, None].expand(20, 5)
    walk, turntable, cut_outs = (replace(lit(20), coverage=part) for part in (share, (share > 0.9).float(), 0 * share))
    assert torch.equal(weight_of_found_light(walk), weight_of_known_light(walk))
    assert len(weight_of_known_light(turntable).unique()) == 2 and len(weight_of_found_light(turntable).unique()) == 1
    assert torch.equal(weight_of_found_light(cut_outs), weight_of_known_light(cut_outs))
