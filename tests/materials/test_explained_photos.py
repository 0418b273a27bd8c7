"""The score of a ball whose photos were made by brute-force Monte Carlo: a right asset, and assets with one thing wrong."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from blender_nep.capture.rays.pixel_width import pixel_width
from blender_nep.capture.rays.response_curve import ResponseCurve
from blender_nep.geometry.ray_tracing import RayTracer
from blender_nep.materials.explained_photos import OF_HITS, NoRadiance, TexturedSurface, explain_photos
from blender_nep.shading.plenoptic import PlenopticFunction
from support.lit_ball import HALF_ANGLE, RADIUS, AnalyticEnvironment, constant, make_photos, unwrapped_ball


class Light(AnalyticEnvironment):
    """The same light. A camera sees it as a radiance of `behind` everywhere."""

    preset = SimpleNamespace(camera_near=0.1)
    behind = 0.0

    def render(self, origins, directions, t_near, t_far, half_angle):
        return SimpleNamespace(radiance=torch.full_like(origins, self.behind))


ALBEDO, ROUGHNESS = np.float32([0.8, 0.5, 0.3]), 0.3


@pytest.fixture(scope="module")
def photos():
    rays = make_photos(constant(tuple(ALBEDO.tolist()), ROUGHNESS, 1.0), views=6)
    rays.background = False
    return rays


@pytest.fixture(scope="module")
def score(photos):
    """score(albedo, roughness, metallic, every) is that of a ball with these textures on one of `every` pixels.

    `shown` are the photos, and of_camera is what `explain_photos` is told of them.
    """
    ball = unwrapped_ball()
    tracer = RayTracer(ball.vertices, ball.faces)
    light = Light()
    f_p = PlenopticFunction(tracer, ball.normals, light, NoRadiance(), OF_HITS, "cpu")

    def of(albedo=ALBEDO, roughness=ROUGHNESS, metallic=1.0, every=1, shown=photos, own_gains=True, behind=0.0, **of_camera):
        flat = np.ones((8, 8), np.float32)
        textures = {"albedo": flat[..., None] * albedo, "roughness": roughness * flat, "metallic": metallic * flat}
        asset, light.behind = TexturedSurface(ball, textures), behind
        found = explain_photos(asset, f_p, light, shown, every, own_gains, 0, **of_camera)
        assert found.surroundings is None  # the photos are cut-outs
        return found.object

    return of


def test_the_right_asset_explains_the_photos(score):
    found = score()
    assert found.psnr > 28 and found.hue_deg < 2 and found.pixels > 500
    assert all(gain == pytest.approx(1, abs=0.05) for gain in found.gains.values())


def test_a_wrong_hue_shows_as_much_as_it_is_wrong(score, photos):
    wrong = np.float32([0.7, 1, 1])
    shown = photos.radiance[(photos.radiance > 0).all(1)].double().numpy()
    cosine = (shown * shown * wrong).sum(1) / np.linalg.norm(shown, axis=1) / np.linalg.norm(shown * wrong, axis=1)
    found = score(albedo=ALBEDO * wrong)
    assert found.hue_deg == pytest.approx(np.degrees(np.arccos(cosine)).mean(), rel=0.1)
    assert found.psnr < score().psnr - 2


@pytest.mark.parametrize("wrong", [{"roughness": 0.4}, {"roughness": 0.2}, {"metallic": 0.0}])
def test_a_wrong_material_lowers_the_score(score, wrong):
    assert score(**wrong).psnr < score().psnr - 2


def test_the_more_a_roughness_is_off_the_lower_the_score(score):
    scores = [score(roughness=ROUGHNESS + more).psnr for more in (0, 0.05, 0.1, 0.2)]
    assert scores == sorted(scores, reverse=True)


def test_only_held_out_pixels_are_scored(score, photos):
    spoiled = torch.where(torch.arange(len(photos.radiance))[:, None] % 5 == 0, photos.radiance, 3.0)
    other = replace(photos, radiance=spoiled)
    other.background = False
    assert score(every=5, shown=other) == score(every=5)
    assert score(every=1, shown=other).psnr < score().psnr - 10


def test_the_objects_brightness_is_evened_before_the_curve(score, photos):
    """Where a camera has a curve, photos of an object that is not as bright in all score as those of one brightness."""
    curve = ResponseCurve.of(2.0, 1.0, 0.1)
    gain = torch.tensor([0.6, 1.6, 1.0, 0.8, 1.3, 1.0])
    even, odd = (
        replace(photos, radiance=curve.photo(light))
        for light in (photos.radiance, photos.radiance * gain[photos.view][:, None])
    )
    even.background = odd.background = False
    alike = score(shown=even, own_gains=False, response=curve)
    assert score(shown=odd, own_gains=False, response=curve, object_gain=gain).psnr == pytest.approx(alike.psnr, abs=0.01)
    assert score(shown=odd, own_gains=False, response=curve).psnr < alike.psnr - 3


def test_the_score_is_the_same_each_time(score):
    assert score() == score()


def test_photos_that_hardly_show_the_object_have_no_score(score, photos):
    assert score(every=10**9, shown=photos) is None
    other = replace(photos)
    other.background, other.sphere = False, other.sphere[:0]
    assert score(shown=other) is None


def test_a_rough_metal_under_a_small_lamp_has_no_noise(score):
    """A small lamp in a wide lobe: few cones would miss it at some points and meet it at others."""
    rough = make_photos(constant(tuple(ALBEDO.tolist()), 0.6, 1.0), views=6)
    rough.background = False
    assert score(roughness=0.6, shown=rough).psnr > 30


def test_a_mask_that_is_a_pixel_too_wide_costs_nothing(score, photos):
    """Pixels of the mask beside the mesh are at its edge, where no asset is judged. Parts that are missing count."""
    along = (photos.origin * photos.direction).sum(1)
    beside = (photos.origin.square().sum(1) - along**2).clamp_min(0).sqrt() - RADIUS
    pixel = pixel_width(HALF_ANGLE) * photos.origin.norm(dim=1)

    def found(pixels):
        shown = replace(photos)
        shown.background, shown.mask = False, torch.where(beside < pixels * pixel, 255, 0).to(torch.uint8)
        return score(shown=shown, behind=1.0)

    assert found(1.0).psnr == pytest.approx(found(0.0).psnr, abs=0.2)
    assert found(6.0).psnr < found(0.0).psnr - 5
