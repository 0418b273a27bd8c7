"""Corrections by an artist: what the artist says is right wins, and all else stays as it was learned."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from blender_nep.materials.corrections import Correction
from blender_nep.materials.palette.search import FoundPalette
from blender_nep.materials.training import _MaterialLearner
from blender_nep.shading.light_moments import LightMoments
from support.lit_ball import PRESET, RADIUS, check_kept, learn, make_photos

MORE = replace(PRESET, samples=3000, label_pixels=6000)
GOLD, RED = torch.tensor([0.95, 0.7, 0.35]), torch.tensor([0.6, 0.1, 0.08])
TEXTURES = ("albedo", "roughness", "metallic", "confidence")


def gold_below_red(points):
    """Gold of roughness 0.2 below the equator, red paint of roughness 0.4 above it."""
    gold = (points[:, 2] < 0)[:, None]
    return torch.where(gold, GOLD, RED), torch.where(gold, 0.2, 0.4)[:, 0], gold[:, 0].float()


@pytest.fixture(scope="module")
def photos():
    return make_photos(gold_below_red, views=16, side=48, rays=64)


@pytest.fixture(scope="module")
def learned(ball, photos):
    return learn(ball, photos, MORE)


@pytest.fixture(scope="module")
def without_metal(ball, photos):
    """The same photos, learned as if nothing were metal."""
    return learn(ball, photos, replace(MORE, metallic=(0.0,)))


def number_of(result, color):
    """The number of the material whose hue is nearest to a color."""
    listed = np.array([entry["albedo"] for entry in result.kept.listed()])
    hue = listed / listed.sum(1, keepdims=True)
    return int(np.abs(hue - (color / color.sum()).numpy()).sum(1).argmin())


def at_pole(ball, texture, sign):
    """Mean of a texture over the half of the charts around one pole: far from the boundary between the materials."""
    inside = sign * ball.vertices[:, 2] > 0.4 * RADIUS
    uv = ball.uv[inside]
    size = len(texture)
    row, column = ((1 - uv[:, 1]) * size).astype(int).clip(0, size - 1), (uv[:, 0] * size).astype(int).clip(0, size - 1)
    return texture[row, column].mean(0)


def test_without_corrections_the_textures_are_as_learned(ball, learned):
    textures, listed = learned.kept.bake(ball, {}, MORE)
    assert all(np.array_equal(a, getattr(learned, name)) for a, name in zip(textures, TEXTURES, strict=True))
    assert listed == learned.kept.listed() and len(listed) == 2
    assert sum(entry["share"] for entry in listed) == pytest.approx(1, abs=1e-3)
    assert all(entry["learned"] == {k: entry[k] for k in ("roughness", "metallic")} for entry in listed)


def test_what_is_kept_survives_the_disk(ball, learned, tmp_path):
    check_kept(learned.kept, ball, tmp_path / "kept.pt", MORE)


def test_saying_that_it_is_metal_finds_albedo_and_roughness(ball, without_metal):
    """The lower half is gold. It was learned as a dielectric, so only the artist can know."""
    k = number_of(without_metal, GOLD)
    textures, listed = without_metal.kept.bake(ball, {k: Correction(metallic=1.0)}, MORE)
    albedo, _, metallic, _ = textures
    assert listed[k]["metallic"] == 1 and listed[k]["learned"]["metallic"] == 0
    assert listed[k]["albedo"] == pytest.approx(GOLD.tolist(), abs=0.03)
    assert listed[k]["roughness"] == pytest.approx(0.2, abs=0.03)
    # blends stay as they were found with the wrong material, so a little red is left
    assert at_pole(ball, metallic, -1) > 0.8 and at_pole(ball, metallic, 1) < 0.05
    error, before = (np.abs(at_pole(ball, t, -1) - GOLD.numpy()).max() for t in (albedo, without_metal.albedo))
    assert error < 0.1 and before > 0.4, "the dielectric has another albedo"


def test_a_given_roughness_is_taken_and_nothing_else_changes(ball, learned):
    k = number_of(learned, GOLD)
    (albedo, roughness, metallic, _), listed = learned.kept.bake(ball, {k: Correction(roughness=0.55)}, MORE)
    assert listed[k]["roughness"] == pytest.approx(0.55, abs=1e-4)
    unblended = learned.metallic > 1 - 1e-6
    assert unblended.mean() > 0.3 and np.abs(roughness[unblended] - 0.55).max() < 1e-4
    paint = learned.metallic < 1e-6
    for before, now in ((learned.roughness, roughness), (learned.albedo, albedo)):
        assert paint.mean() > 0.3 and np.array_equal(before[paint], now[paint])
    np.testing.assert_allclose(metallic, learned.metallic, atol=1e-6)
    assert listed[1 - k] == learned.kept.listed()[1 - k]


def test_a_material_shown_by_blends_alone_keeps_its_values(learned):
    materials = learned.kept.materials
    k = number_of(learned, RED)
    blended = replace(materials, label=torch.where(materials.label == k, -1, materials.label))
    palette = blended.corrected({k: Correction(metallic=1.0)}, MORE).palette
    assert palette.metallic[k] == 1 and palette.roughness[k] == materials.palette.roughness[k]
    assert torch.equal(palette.albedo[k], materials.palette.albedo[k])


def test_samples_that_no_fit_uses_tell_a_correction_nothing(learned):
    """Every second sample of the first material is doubtful."""
    light, label = learned.kept.materials.light, torch.tensor([0] * 8 + [1] * 8)
    found = FoundPalette(learned.kept.materials.palette.pick([0, 1]), label, doubtful=torch.arange(16) % 2 > label)
    learner = SimpleNamespace(found=found, light=light, search=SimpleNamespace(target=torch.zeros(16, 3)))
    kept = _MaterialLearner._correctable_palette(learner, learned.kept.materials.points)
    assert kept.label.tolist() == [0, -1] * 4 + [1] * 8


def test_a_correction_tries_no_lobes_that_were_not_gathered(ball, without_metal):
    """The light of matte objects is gathered in wide lobes alone."""
    kept, k = without_metal.kept, number_of(without_metal, GOLD)
    light = kept.materials.light
    wide = LightMoments(
        light.specular[:, 6:], light.diffuse, light.coverage[:, 6:], light.cos_v, roughness_levels=light.roughness_levels[6:]
    )
    least = float(wide.roughness_levels[0])
    matte = replace(kept, materials=replace(kept.materials, light=wide))
    assert kept.bake(ball, {k: Correction(metallic=1.0)}, MORE)[1][k]["roughness"] < least - 0.02
    assert matte.bake(ball, {k: Correction(metallic=1.0)}, MORE)[1][k]["roughness"] >= least - 1e-4


def test_the_learned_class_and_roughness_give_the_learned_albedo(ball, learned):
    """A correction that says what was learned is no change, but for the fit to unblended samples alone."""
    for k, entry in enumerate(learned.kept.listed()):
        wanted = {k: Correction(metallic=entry["metallic"], roughness=entry["roughness"])}
        assert learned.kept.bake(ball, wanted, MORE)[1][k]["albedo"] == pytest.approx(entry["albedo"], abs=0.03)
