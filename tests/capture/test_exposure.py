"""Exposures of photos: known ones are found again, and none are found where photos cannot tell."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from blender_nep.asset.preview import PreviewView
from blender_nep.capture import PixelRays, load_capture
from blender_nep.capture.exposure import surroundings
from blender_nep.capture.exposure.surroundings import SPHERES, Exposures, stops
from blender_nep.checkpoints import NoCheckpoint
from blender_nep.fields.training import FieldsLearning, learn_fields
from blender_nep.geometry.ray_tracing import RayTracer
from blender_nep.job.reporting.live_preview import render_pair
from blender_nep.materials.samples.photo_samples import select_samples
from blender_nep.messages import Message
from blender_nep.scene.photo_analysis import PhotoAnalysis
from blender_nep.scene.scene import Scene
from blender_nep.scene.surface_analysis import view_dependence
from support.brief_preset import brief_preset
from support.exposures import find_exposures
from support.paths import SUZANNE_SMALL
from support.table_scene import write_table_scene
from support.true_mesh import true_surface

TENTH_OF_A_STOP = 0.07
"""ln 2 / 10"""


def gains(views: int, deviation: float, seed: int, hue: float = 0.0) -> torch.Tensor:
    """Random factors [views, 3] of geometric mean 1; deviations of the logarithms, together and of each channel."""
    random = torch.Generator().manual_seed(seed)
    log = deviation * torch.randn(views, 1, generator=random) + hue * torch.randn(views, 3, generator=random)
    return (log - log.mean(0)).exp()


def taken_with(rays: PixelRays, gain: torch.Tensor) -> PixelRays:
    return replace(rays, radiance=rays.radiance * gain[rays.view_of(torch.arange(rays.count))])


def difference(found: torch.Tensor, true: torch.Tensor) -> float:
    return float((found.log() - true.log()).square().mean().sqrt())


@pytest.fixture
def make_ball(make_capture):
    """make_ball(radius): photos from within a colored ball, of a radius in camera distances; each sees a sixth of it."""
    rays = PixelRays.from_capture(load_capture(make_capture(views=40, size=64).folder), 40_000, False)
    return lambda radius: in_ball(rays, radius)


@pytest.fixture
def in_a_ball(make_ball):
    """The ball is between two of the spheres that are tried."""
    return make_ball(4.1)


def in_ball(rays: PixelRays, radius: float) -> PixelRays:
    origin, direction, _ = rays.rays(torch.arange(rays.count))
    distance = radius * float(origin.norm(dim=-1).mean())
    along = (origin * direction).sum(-1)
    t = -along + (along**2 - origin.square().sum(-1) + distance**2).sqrt()
    place = (origin + t[:, None] * direction) / distance
    color = 0.3 + 0.2 * torch.sin(5 * place + torch.tensor([0.0, 1.0, 2.0])) * torch.cos(4 * place.roll(1, -1))
    return replace(rays, radiance=color)


@pytest.mark.parametrize(("seed", "radius"), [(0, 4.1), (1, 4.1), (2, SPHERES[4])])
def test_known_exposures_and_white_balances_are_found_again(make_ball, seed, radius):
    ball = make_ball(radius)
    true = gains(ball.views, 0.4, seed, hue=0.1)
    found = find_exposures(taken_with(ball, true)).gain
    assert difference(found, true) < TENTH_OF_A_STOP
    torch.testing.assert_close(found.log().mean(0), torch.zeros(3), atol=1e-5, rtol=0)


def test_photos_of_one_exposure_are_left_alone(in_a_ball):
    assert find_exposures(in_a_ball) == Exposures(None)
    rays = PixelRays.from_capture(load_capture(SUZANNE_SMALL), 40_000, False)
    assert find_exposures(rays) == Exposures(None)


@pytest.mark.parametrize("deviation", [0.25, 0.7])
def test_exposures_of_renderings_are_found_to_a_tenth_of_a_stop(deviation):
    rays = PixelRays.from_capture(load_capture(SUZANNE_SMALL), 40_000, False)
    true = gains(rays.views, deviation, 4)
    assert difference(find_exposures(taken_with(rays, true)).gain, true) < TENTH_OF_A_STOP


@pytest.mark.parametrize("tilt", [pytest.param(0.0, marks=pytest.mark.slow), 0.3])
def test_exposures_are_found_above_a_table_too(tmp_path, monkeypatch, tilt):
    folder = write_table_scene(tmp_path / "capture", tilt=tilt, elevations=(10, 15, 60))
    table = PixelRays.from_capture(load_capture(folder), 40_000, False)
    assert find_exposures(table).gain is None
    true = gains(table.views, 0.4, 1)
    with_planes = difference(find_exposures(taken_with(table, true)).gain, true)
    monkeypatch.setattr(surroundings, "PLANES", ())
    spheres_alone = find_exposures(taken_with(table, true)).gain
    assert with_planes < min(TENTH_OF_A_STOP, 0.7 * difference(spheres_alone, true))


def test_white_balance_alone_is_found_too(in_a_ball):
    true = gains(in_a_ball.views, 0, 8, hue=0.25)
    true = (true.log() - true.log().mean(1, keepdim=True)).exp()
    rays = taken_with(in_a_ball, true)
    found = find_exposures(rays).gain
    assert difference(found, true) < TENTH_OF_A_STOP
    assert Message("scene.white_balance_differs") in PhotoAnalysis.of(rays.with_gain(true)).sentences()


def test_clipped_pixels_are_left_out_when_exposures_are_found(in_a_ball, monkeypatch):
    true = gains(in_a_ball.views, 0.4, 5)
    clipped = taken_with(in_a_ball, 1.6 * true)
    clipped = replace(clipped, radiance=clipped.radiance.clamp(max=1))
    assert (clipped.radiance == 1).any(-1).float().mean() > 0.1
    without_white = difference(find_exposures(clipped).gain, true)
    monkeypatch.setattr(surroundings, "SATURATED", 2.0)
    assert without_white < min(0.1, 0.8 * difference(find_exposures(clipped).gain, true))


def test_no_exposures_are_found_where_photos_cannot_tell(in_a_ball, make_capture):
    alone = make_capture(views=8, masks=True, alpha=True, name="cut").folder
    cut = PixelRays.from_capture(load_capture(alone), 40_000, True)
    assert not cut.background and find_exposures(cut) == Exposures(None)
    dark = replace(in_a_ball, radiance=torch.zeros_like(in_a_ball.radiance))
    assert find_exposures(dark) == Exposures(None)
    noise = torch.rand(in_a_ball.radiance.shape, generator=torch.Generator().manual_seed(0))
    assert find_exposures(replace(in_a_ball, radiance=noise)).gain is None
    # photos of which each shows something else, in cells that happen to be the same
    random = torch.Generator().manual_seed(1)
    other = in_a_ball.radiance.roll(997, 0) * torch.rand(in_a_ball.count, 1, generator=random).pow(3)
    assert find_exposures(taken_with(replace(in_a_ball, radiance=other), gains(in_a_ball.views, 0.4, 2))).gain is None


@pytest.mark.parametrize("shows", [0, 5])
def test_a_photo_that_shares_little_is_guessed_and_named(in_a_ball, shows):
    true = gains(in_a_ball.views, 0.4, 6)
    rays = taken_with(in_a_ball, true)
    start, end = rays.offset[3:5]
    valid = rays.valid.clone()
    valid[start:end] = False
    valid[start:end].view(rays.size[3])[:shows, :shows] = True
    found = find_exposures(replace(rays, valid=valid))
    others = [v for v in range(rays.views) if v != 3]
    log = found.gain.log() - true.log()
    log = log - log[others].mean(0)
    assert float(log[others].square().mean().sqrt()) < TENTH_OF_A_STOP
    assert found.warning == Message("capture.exposure_guessed", {"count": 1}) and found.gain.isfinite().all()
    if shows:
        assert log[3].abs().max() < 0.7


def test_no_exposures_are_found_from_too_few_photos(make_capture):
    rays = PixelRays.from_capture(load_capture(make_capture(views=6, name="few").folder), 40_000, False)
    assert find_exposures(rays) == Exposures(None) == find_exposures(taken_with(rays, gains(6, 0.5, 0)))


def test_photos_are_read_as_of_one_exposure_as_the_scene_says(in_a_ball):
    true = gains(in_a_ball.views, 0.5, 7)
    rays = taken_with(in_a_ball, true).with_gain(true)
    index = torch.tensor([0, 5, rays.offset[9] + 3, rays.count - 1])
    torch.testing.assert_close(rays.photo(index), in_a_ball.radiance[index], rtol=1e-5, atol=1e-6)
    assert torch.equal(in_a_ball.photo(index), in_a_ball.radiance[index])
    assert stops(true) == pytest.approx((true.log()[:, 0] / np.log(2)).tolist(), abs=0.006)
    spread = np.ptp(stops(true))
    assert Message("scene.exposure_differs", {"stops": spread}) in PhotoAnalysis.of(rays).sentences()
    assert "exposure" not in " ".join(line.code for line in PhotoAnalysis.of(in_a_ball).sentences())


def test_the_brightest_value_is_computed_once(in_a_ball):
    assert in_a_ball.brightest == float(in_a_ball.radiance.max())
    in_a_ball.radiance[0] = 9.0
    assert in_a_ball.with_gain(None).brightest < 9


@pytest.mark.slow
def test_no_result_depends_on_the_exposures_of_the_photos(tmp_path):
    """Gains that are powers of two change no bit of what is learned or shown."""
    rays = PixelRays.from_capture(load_capture(SUZANNE_SMALL), 2500, True)
    true = 2.0 ** torch.randint(-2, 3, (rays.views, 1), generator=torch.Generator().manual_seed(3)).expand(-1, 3).float()
    other = taken_with(rays, true).with_gain(true)
    surface = true_surface()
    tracer = RayTracer(surface.vertices, surface.faces)
    rays_per_step = {"object_rays": 128, "sphere_rays": 128, "outside_rays": 128}
    p = brief_preset(background_steps=8, least_explanation_ratio=0, **rays_per_step)

    def all_of(photos: PixelRays) -> list:
        fields = learn_fields(
            Scene.of(photos),
            p,
            seed=0,
            progress=lambda *_: None,
            checkpoint=NoCheckpoint(),
            watch=lambda learning: watched.append(learning),
        )
        samples = select_samples(
            photos, tracer, surface.normals, count=300, least_cosine=0.2, generator=np.random.default_rng(0)
        )
        textures = {"albedo": np.full((4, 4, 3), 0.5), "roughness": np.full((4, 4, 1), 0.3), "metallic": np.zeros((4, 4, 1))}
        return [
            fields.report,
            fields.environment.raw.detach().numpy(),
            samples.radiance.numpy(),
            PreviewView.best(photos, surface).render(surface, textures, np.ones((8, 16, 3))),
            render_pair(watched[-1], 2),
            view_dependence(tracer, surface.normals, photos, np.random.default_rng(0)),
        ]

    watched: list[FieldsLearning] = []
    for one, same in zip(all_of(rays), all_of(other), strict=True):
        np.testing.assert_equal(one, same)
