"""Material learning end to end: photos of a sphere made by brute-force Monte Carlo, materials known."""

import functools
import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from blender_nep.errors import LearningError
from blender_nep.geometry.uv_raster import rasterize
from blender_nep.materials.baking import LabeledPoints, bake
from blender_nep.materials.shown_faces import ShownParts
from support.lit_ball import (
    PRESET,
    AnalyticEnvironment,
    Counting,
    HalfSeen,
    MemoryCheckpoint,
    Misled,
    constant,
    learn,
    make_photos,
)

GOLD = ((0.9, 0.6, 0.3), 0.18, 1.0)


@pytest.fixture(scope="module")
def photos_of():
    """photos_of(albedo, roughness, metallic, ...) -> photos, which are made once. No test may change them."""
    return functools.cache(lambda *material, **options: make_photos(constant(*material), **options))


@pytest.mark.parametrize(
    ("albedo", "roughness", "metallic", "tolerance"),
    [
        (*GOLD, 0.03),
        ((0.5, 0.1, 0.1), 0.15, 0.0, 0.03),
        pytest.param((0.7, 0.7, 0.7), 0.5, 1.0, 0.03, marks=pytest.mark.slow),
        pytest.param((0.2, 0.4, 0.7), 0.6, 0.0, 0.1, marks=pytest.mark.slow),
    ],
)  # a rough coat is 4 % of the light and shows little of its width
def test_one_material_is_recovered(ball, photos_of, albedo, roughness, metallic, tolerance):
    result = learn(ball, photos_of(albedo, roughness, metallic))
    assert np.abs(result.albedo - albedo).max() < 0.04
    assert np.abs(result.roughness - roughness).max() < tolerance
    assert (result.metallic == metallic).all()
    assert len(result.report["materials"]) == 1
    assert result.confidence.max() > 0.5 and result.confidence.min() >= 0


@pytest.mark.parametrize("unclear", [PRESET.unclear_classes, 0.0], ids=["each place", "up to edges of color"])
def test_paint_and_metal_are_told_apart_where_they_lie(ball, unclear):
    def two(points):
        metal = (points[:, 0] > 0).float()
        red, pale = torch.tensor([0.6, 0.06, 0.05]), torch.tensor([0.85, 0.8, 0.7])
        return red + (pale - red) * metal[:, None], 0.15 + 0.1 * metal, metal

    result = learn(ball, make_photos(two))
    face, barycentric = rasterize(ball.uv, ball.faces, len(result.metallic))
    known = face >= 0
    points = np.einsum("nc,nck->nk", barycentric[known], ball.vertices[ball.faces[face[known]]])
    clear = np.abs(points[:, 0]) > 0.05
    metal = points[clear, 0] > 0
    assert ((result.metallic[known][clear] > 0.5) == metal).mean() > 0.97
    truth = np.where(metal[:, None], [0.85, 0.8, 0.7], [0.6, 0.06, 0.05])
    assert ((result.albedo[known][clear] - truth) ** 2).mean() < 0.004
    assert ((result.roughness[known][clear] - np.where(metal, 0.25, 0.15)) ** 2).mean() < 0.001


def test_unseen_faces_have_no_confidence_whatever_the_block(ball, monkeypatch):
    random = np.random.default_rng(2)
    at = random.integers(len(ball.vertices), size=300)
    position, normal = ball.vertices[at].astype(np.float32), ball.normals[at].astype(np.float32)
    material = (random.random(shape).astype(np.float32) for shape in ((300, 3), 300, 300, 300))
    evidence = LabeledPoints(position, normal, random.integers(9, size=300), *material)
    whole = bake(ball, evidence, 64)
    shown = ball.vertices[ball.faces].mean(1)[:, 2] > 0
    *same, confidence = bake(ball, evidence, 64, ShownParts(np.ones(len(shown), np.int64), shown))
    face = rasterize(ball.uv, ball.faces, 64)[0]
    inside, on_shown = face >= 0, shown[np.maximum(face, 0)]
    assert (confidence[inside & ~on_shown] == 0).all() and (confidence[inside & on_shown] > 0).all()
    assert np.array_equal(confidence[inside & on_shown], whole[-1][inside & on_shown])
    assert all(np.array_equal(a, b) for a, b in zip(whole[:-1], same, strict=True))
    monkeypatch.setattr("blender_nep.materials.baking._BLOCK", 37)
    assert all(np.array_equal(a, b) for a, b in zip(whole, bake(ball, evidence, 64), strict=True))


def test_same_seed_same_textures_also_when_resumed(ball):
    photos = make_photos(constant((0.9, 0.6, 0.3), 0.2, 1.0), views=5, rays=32)
    checkpoint = MemoryCheckpoint(always=True)
    whole, rest = Counting(), Counting()
    a, b = learn(ball, photos, checkpoint=checkpoint, environment=whole), learn(ball, photos)
    resumed = learn(ball, photos, checkpoint=MemoryCheckpoint(checkpoint.state), environment=rest)
    assert rest.cones < 0.01 * whole.cones, "the light is that of the checkpoint"
    for other in (b, resumed):
        assert (a.albedo == other.albedo).all() and (a.roughness == other.roughness).all()


@pytest.mark.parametrize(
    ("albedo", "metallic"), [pytest.param((0.9, 0.6, 0.3), 1.0, marks=pytest.mark.slow), ((0.6, 0.3, 0.15), 0.0)]
)
def test_light_that_no_photo_shows_is_found_in_the_reflections(ball, albedo, metallic):
    photos = make_photos(constant(albedo, 0.2, metallic))
    preset = replace(PRESET, most_materials=1, unseen_steps=60)
    found, ignored = (
        learn(ball, photos, replace(preset, learn_unseen_light=learned), environment=HalfSeen()) for learned in (True, False)
    )
    error, error_ignored = (np.abs(result.albedo - albedo).max() for result in (found, ignored))
    # A metal's albedo is nearly right without the light, too, because its fit does not follow what is unexplained.
    assert error < 0.1 and error < (0.5 if metallic == 0 else 1) * error_ignored
    assert found.report["residual"] < 0.6 * ignored.report["residual"]
    assert found.metallic.mean() == metallic and np.abs(found.roughness - 0.2).max() < 0.06
    assert torch.equal(ignored.unseen.radiance, ignored.unseen.expected) and "unseen light" in ignored.report["skipped"]
    area = torch.sin((torch.arange(5) + 0.5) * math.pi / 16)[:, None, None]  # the rows that no photo shows
    light, true = (whole[:5] for whole in (found.unseen.equirect(16), AnalyticEnvironment().equirect(16)[0]))
    assert abs((light * area).sum() / (true * area).sum() - 1) < 0.1
    assert np.corrcoef(light.mean(-1).log().flatten(), true.mean(-1).log().flatten())[0, 1] > 0.85


def test_what_no_photo_shows_does_not_darken_a_metal(ball):
    albedo = (0.9, 0.6, 0.3)
    photos = make_photos(constant(albedo, 0.2, 1.0))
    result = learn(ball, photos, replace(PRESET, most_materials=1, unseen_steps=60), environment=Misled())
    assert result.metallic.all() and np.abs(result.albedo - albedo).max() < 0.05


BLACK_MIRRORING_PAINT = (0.0, 0.0, 0.02)


@pytest.mark.parametrize(
    ("albedo", "metallic", "roughness"),
    [
        pytest.param(*values, marks=[pytest.mark.slow] * (values != BLACK_MIRRORING_PAINT))
        for values in itertools.product((0.0, 1.0), (0.0, 1.0), (0.02, 1.0))
    ],
)
def test_extreme_materials_under_a_blinding_lamp_stay_sensible(ball, albedo, metallic, roughness):
    class Blinding(HalfSeen):
        def __init__(self):
            super().__init__()
            self.color[3] *= 1e4

    photos = make_photos(constant((albedo,) * 3, roughness, metallic), views=4, rays=32, environment=Blinding())
    result = learn(ball, photos, environment=Blinding())
    for texture in (result.albedo, result.roughness, result.metallic, result.confidence):
        assert np.isfinite(texture).all() and texture.min() >= 0 and texture.max() <= 1
    assert torch.isfinite(result.unseen.radiance).all()
    if albedo == 0 and metallic == 0:
        assert result.albedo.mean() < 0.2, "a black body is not bright"


@pytest.mark.parametrize("scale", [0.0, 1e4])
def test_black_and_blinding_light_give_finite_textures(ball, scale):
    photos = make_photos(constant((0.9, 0.6, 0.3), 0.02, 1.0), views=4, rays=16)
    photos.radiance = photos.radiance * scale
    result = learn(ball, photos)
    for texture in (result.albedo, result.roughness, result.metallic, result.confidence):
        assert np.isfinite(texture).all() and texture.min() >= 0 and texture.max() <= 1


def test_a_handful_of_pixels_still_gives_one_material(ball, photos_of):
    result = learn(ball, photos_of(*GOLD), replace(PRESET, samples=60))
    assert len(result.report["materials"]) == 1 and np.abs(result.albedo - GOLD[0]).max() < 0.15


EVERYTHING = replace(PRESET, samples=600, most_materials=1, unseen_rows=8, sure_margin=math.inf, uniform_texels=256)


@pytest.fixture(scope="module")
def with_everything(ball, photos_of):
    """What is learned of a convex metal ball if nothing is left out."""
    return learn(ball, photos_of((0.9, 0.6, 0.3), 0.2, 1.0, views=5, rays=64), EVERYTHING, environment=HalfSeen())


@pytest.mark.parametrize(
    "left_out", [{"levels": 0}, {"irradiance_cones": 0, "metallic": (1.0,)}, {"sure_margin": 0.15, "uniform_texels": 16}]
)
def test_what_a_convex_metal_ball_does_not_need_changes_nothing(ball, photos_of, with_everything, left_out):
    photos, whole = photos_of((0.9, 0.6, 0.3), 0.2, 1.0, views=5, rays=64), with_everything
    less = learn(ball, photos, replace(EVERYTHING, **left_out), environment=HalfSeen())
    for name in ("albedo", "roughness", "metallic"):
        a, b = (getattr(result, name) for result in (whole, less))
        assert np.abs(a.mean((0, 1)) - b.mean((0, 1))).max() < 0.02 and np.ptp(b, (0, 1)).max() < 1e-6, name
    assert less.report["skipped"].items() >= whole.report["skipped"].items()
    if left_out.get("uniform_texels"):
        assert less.albedo.shape == (16, 16, 3) and whole.albedo.shape == (256, 256, 3)
        assert less.report["seconds_saved"]["fine textures"] > 0
        assert "asking again whether it is metal" in less.report["skipped"]
    elif "irradiance_cones" in left_out:
        assert less.report["cones_traced"] < 0.7 * whole.report["cones_traced"]


@pytest.mark.parametrize(("told", "metallic"), [((0.0,), 0.0), ((1.0,), 1.0)])
def test_who_knows_whether_it_is_metal_decides(ball, told, metallic):
    photos = make_photos(constant((0.9, 0.6, 0.3), 0.3, 1.0 - metallic), views=5, rays=32)
    result = learn(ball, photos, replace(PRESET, metallic=told))
    assert (result.metallic == metallic).all()


def test_a_surface_that_no_photo_shows_says_so(ball):
    photos = make_photos(constant((0.5, 0.5, 0.5), 0.5, 0.0), views=2, rays=4)
    photos.direction = -photos.direction
    with pytest.raises(LearningError):
        learn(ball, photos)
