"""The light of more samples must be like that of the first: the seen, the unseen, and what the object reflects to itself."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh
from scipy.spatial import cKDTree

from blender_nep.geometry.mesh import Surface
from blender_nep.materials.samples.light_gathering import Observations, with_more_samples
from blender_nep.materials.segments.segments import Segments, features
from blender_nep.materials.segments.varied_materials import fit_segments, gain_of_unseen_light
from blender_nep.shading import brdf
from blender_nep.shading.incoming_light import IncomingLight
from blender_nep.shading.light_moments import LightMoments
from blender_nep.shading.plenoptic import Material, reflected
from blender_nep.shading.unseen_light import UnseenLight
from support.lit_ball import PRESET, HalfSeen, SyntheticRays, lit_scene

LIT = replace(PRESET, samples=4000)


def white_metal(points):
    n = len(points.position)
    return Material(torch.ones(n, 3), torch.full((n,), 0.3), torch.ones(n))


@pytest.fixture(scope="module")
def two_balls():
    """Two spheres that nearly touch, so that they reflect each other, as seen from all around."""
    mesh = trimesh.util.concatenate(
        [trimesh.creation.icosphere(subdivisions=3, radius=0.33).apply_translation([x, 0, 0]) for x in (-0.35, 0.35)]
    )
    vertices = np.asarray(mesh.vertices)
    normals = vertices - np.sign(vertices[:, :1]) * [[0.35, 0, 0]]
    surface = Surface(vertices, np.asarray(mesh.faces), normals / np.linalg.norm(normals, axis=1, keepdims=True))
    generator = torch.Generator().manual_seed(11)
    eye = torch.nn.functional.normalize(torch.randn(12, 3, generator=generator), dim=-1) * 3
    u = (torch.arange(60) + 0.5) / 60 * 0.5 - 0.25
    x, y = torch.meshgrid(u, u, indexing="ij")
    frame = brdf.frame(torch.nn.functional.normalize(-eye, dim=-1))
    local = torch.nn.functional.normalize(torch.stack([x, y, torch.ones_like(x)], -1).reshape(-1, 3), dim=-1)
    direction = torch.einsum("vij,nj->vni", frame, local).reshape(-1, 3)
    view = torch.arange(12).repeat_interleave(len(local))
    rays = SyntheticRays(torch.full_like(direction, 0.5), eye[view], direction, view)
    seen = Observations.of(surface, HalfSeen(), lit_scene(rays), LIT, 0)
    light = IncomingLight.gathered(
        seen.f_p,
        seen.points,
        LIT.roughness_levels,
        LIT.irradiance_cones,
        seen.samples.reflection_variance,
        torch.Generator().manual_seed(1),
        lambda _: None,
    )
    unseen = UnseenLight.uniform(LIT.unseen_rows, 4.0, "cpu", 0.5)
    unseen.radiance[1:5, :10] += 20  # a lamp
    return seen, light.updated(white_metal, torch.Generator().manual_seed(2), unseen)


@pytest.fixture(scope="module")
def lit(two_balls):
    seen, light = two_balls
    return with_more_samples(seen, light, white_metal, LIT, 0, torch.Generator().manual_seed(3), lambda _: None)


def painted(lit, true_gain):
    """The samples as a body of 30 paints shows them in `true_gain` times the unseen light, their segments, and the light."""
    position, generator = torch.from_numpy(lit.samples.position), torch.Generator().manual_seed(4)
    centers = position[torch.randperm(len(position), generator=generator)[:30]]
    field = torch.cdist(position, centers).argmin(1)
    albedo = 0.2 + 0.6 * torch.rand(30, 3, generator=generator)
    paint = Material(albedo[field], torch.full((len(field),), 0.3), torch.zeros(len(field)))
    known, both = lit.known, lit.light
    true = LightMoments(
        known.specular + true_gain * (both.specular - known.specular),
        known.diffuse + true_gain * (both.diffuse - known.diffuse),
        both.coverage,
        both.cos_v,
        both.roughness_levels,
    )
    radiance = reflected(paint, true.moments(paint.roughness), true.diffuse, true.cos_v)
    photographed = replace(lit, samples=replace(lit.samples, radiance=radiance))
    segments = Segments.of(lit.samples.position, albedo[field].log().numpy(), 60, 0)
    return photographed, torch.from_numpy(segments.label), segments, true


@pytest.mark.parametrize("true_gain", [0.8, 1.1])
def test_many_paints_tell_how_bright_the_unseen_light_is(lit, true_gain):
    photographed, label, segments, true = painted(lit, true_gain)
    torch.testing.assert_close(lit.with_unseen(true_gain).light.moments_state(), true.moments_state())
    found = gain_of_unseen_light(photographed, label, segments, LIT)
    assert found == pytest.approx(true_gain, abs=0.06)


def test_cut_outs_do_not_tell_it(lit):
    """All their light is unseen, so there is nothing to compare its brightness with."""
    photographed, label, segments, _ = painted(lit, 0.8)
    light = lit.light
    cut_out = LightMoments(light.specular, light.diffuse, 0 * light.coverage, light.cos_v, light.roughness_levels)
    assert gain_of_unseen_light(replace(photographed, light=cut_out), label, segments, LIT) == 1


def test_a_speck_of_gold_is_not_outvoted_by_the_paint_around_it(lit):
    """Its class must not be judged at the roughness that suits the motley paint around it."""
    position = torch.from_numpy(lit.samples.position)
    gold = (position - position[0]).norm(dim=-1) < 0.12
    n = len(gold)
    motley = 0.3 + 0.6 * torch.rand(n, 3, generator=torch.Generator().manual_seed(6))
    albedo = torch.where(gold[:, None], torch.tensor([0.95, 0.7, 0.35]), motley)
    shown = Material(albedo, torch.full((n,), 0.3), gold.float())
    radiance = reflected(shown, lit.light.moments(shown.roughness), lit.light.diffuse, lit.light.cos_v)
    of_paint = Segments.of(position[~gold].numpy(), np.zeros((int((~gold).sum()), 3)), 200, 0)
    label = torch.zeros(n, dtype=torch.int64)
    label[~gold] = 1 + torch.from_numpy(of_paint.label)
    center = features(position[gold].mean(0, keepdim=True).numpy(), np.zeros((1, 3)))  # no color tells them apart
    segments = Segments(np.concatenate([center, of_paint.center]), label.numpy())
    found = fit_segments(lit.light, radiance, label, segments, LIT)
    assert found.metallic[0] == 1
    assert float(found.metallic[1:].mean()) < 0.03


def test_more_samples_have_the_same_light_as_their_neighbors(two_balls, lit):
    seen, light = two_balls
    first, total = len(seen.samples), len(lit.samples)
    assert total == len(lit.light.diffuse) == 2 * first
    assert np.array_equal(lit.samples.position[:first], seen.samples.position)
    assert torch.equal(lit.light.specular[:first], light.specular)
    more = lit.samples.position[first:]
    assert (cKDTree(seen.samples.position).query(more)[0] > 1e-6).mean() > 0.5  # they are other pixels
    _, near = cKDTree(seen.samples.position).query(more, 8)
    facing = np.abs(more[:, 0]) < 0.2  # the other sphere is seen from here
    above = more[:, 2] > 0.15  # the unseen light comes from above
    assert facing.sum() > 200 and above.sum() > 200
    noisy = light.diffuse - light.known_diffuse
    even = lit.light.diffuse[:first] - light.known_diffuse
    _, around = cKDTree(seen.samples.position).query(seen.samples.position[seen.samples.position[:, 2] > 0.15], 8)
    assert even.numpy()[around].std(1).mean() < 0.75 * noisy.numpy()[around].std(1).mean()
    for values in (lit.light.diffuse, lit.light.specular[:, -1, 0], lit.known.diffuse, lit.known.specular[:, -1, 0]):
        expected = values[:first].numpy()[near].mean(1)
        for place in (facing, above, ~facing & ~above):
            found = values[first:].numpy()[place].mean()
            assert found == pytest.approx(expected[place].mean(), rel=0.04)
