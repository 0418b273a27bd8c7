"""Stage 1 on the capture in the repository: what is learned, determinism, resume; the dynamic weight by its formula."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh

from blender_nep.capture import PixelRays, load_capture
from blender_nep.checkpoints import NoCheckpoint
from blender_nep.errors import LearningError
from blender_nep.fields.object_field import Appearance, ObjectField
from blender_nep.fields.training import Fields, FieldsLearning, Rendering, dynamic_weight, learn_fields
from blender_nep.geometry.mesh import Surface
from blender_nep.geometry.ray_tracing import RayTracer
from blender_nep.presets import preset
from blender_nep.tone_mapping import HIGHLIGHT, tone_map, tone_map_without_highlights
from support.brief_preset import brief_preset
from support.paths import SUZANNE_SMALL

CPU = torch.device("cpu")


@pytest.fixture(scope="module")
def rays():
    return PixelRays.from_capture(load_capture(SUZANNE_SMALL), 10_000, False, CPU)


@pytest.fixture(scope="module")
def masked_rays():
    return PixelRays.from_capture(load_capture(SUZANNE_SMALL), 10_000, True, CPU)


def no_progress(step, steps, loss):
    assert 0 < step <= steps and np.isfinite(loss)


def test_dynamic_weight_is_equation_5_and_passes_no_gradient():
    albedo = torch.tensor([[0.2, 0.5, 0.9], [0.1, 0.1, 0.1]], requires_grad=True)
    light = torch.tensor([[1.0, 1.0, 1.0], [30.0, 30.0, 30.0]], requires_grad=True)
    appearance = Appearance(albedo, light, torch.zeros(2, 1))
    weight = dynamic_weight(appearance, "paper", cap=1.5, epsilon=1e-3)
    assert not weight.requires_grad
    torch.testing.assert_close(weight[:, 0], torch.tensor([1.5, 1 / (2.9**2 + 1e-3)]))
    assert (dynamic_weight(appearance, "none") == 1).all()
    scaled = dynamic_weight(appearance, "scaled")
    assert scaled[0] > scaled[1], "where the color is the albedo, the pixel counts more"


def test_a_short_learning_with_masks_comes_nearer_to_the_truth(masked_rays):
    truth = trimesh.load(SUZANNE_SMALL / "gt_mesh.ply", process=False, force="mesh")
    capture = load_capture(SUZANNE_SMALL)
    points = (trimesh.sample.sample_surface(truth, 2000, seed=0)[0] - capture.object_center) / capture.object_radius
    points = torch.from_numpy(points).float()
    chosen = brief_preset(steps=150, object_rays=512, sphere_rays=512, outside_rays=512, least_explanation_ratio=0.0)
    before = FieldsLearning(masked_rays, chosen, 0, CPU).object_field.sdf(points).abs().mean()
    learned = learn_fields(masked_rays, chosen, seed=0, device=CPU, progress=no_progress, checkpoint=NoCheckpoint())
    after = learned.object_field.sdf(points).abs().mean()
    assert after < 0.5 * before, f"{before:.4f} -> {after:.4f}"
    copy = Fields.from_state(learned.state(), chosen, CPU)
    torch.testing.assert_close(copy.object_field.sdf(points), learned.object_field.sdf(points))
    direction = torch.nn.functional.normalize(points, dim=-1)
    torch.testing.assert_close(
        copy.environment.query_cone(points * 0, direction, 0.2), learned.environment.query_cone(points * 0, direction, 0.2)
    )


@pytest.mark.parametrize("stop", [4, 16], ids=["while F_e is learned alone", "with both fields"])
def test_a_resumed_run_gives_the_same_fields(rays, stop):
    def advance(learning, steps):
        for _ in range(steps):
            learning.learn_step()
        return learning

    whole = advance(FieldsLearning(rays, brief_preset(), 3, CPU), 24)
    half = advance(FieldsLearning(rays, brief_preset(), 3, CPU), stop)
    resumed = FieldsLearning(rays, brief_preset(), 3, CPU)
    resumed.load(half.state())
    advance(resumed, 24 - stop)
    assert resumed.step == whole.step and resumed.loss == whole.loss
    for a, b in zip(whole.object_field.parameters(), resumed.object_field.parameters(), strict=True):
        assert torch.equal(a, b)
    assert torch.equal(whole.environment.raw, resumed.environment.raw)


def test_with_a_mesh_the_environment_learns_from_the_pixels_beside_it(rays):
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.7)
    surface = Surface(np.asarray(ball.vertices), np.asarray(ball.faces), np.asarray(ball.vertex_normals))
    chosen = brief_preset()
    chosen = replace(chosen, environment=replace(chosen.environment, steps=5, rays_per_step=256, coverage_rays=1000))
    fields = learn_fields(rays, chosen, seed=0, device=CPU, progress=no_progress, checkpoint=NoCheckpoint(), surface=surface)
    assert fields.object_field is None and "object field" in fields.report["skipped"]
    origins, directions, _ = rays.rays(rays.sphere[:5000])
    hit = RayTracer(surface.vertices, surface.faces).occluded(origins.numpy(), directions.numpy())
    off_axis = torch.linalg.cross(origins, directions).norm(dim=-1).numpy()
    assert (hit[off_axis < 0.68]).all() and not hit[off_axis > 0.7].any()


def test_a_loss_that_is_not_finite_is_given_up_with_a_message(rays):
    learning = FieldsLearning(rays, brief_preset(), 0, CPU)
    with torch.no_grad():
        for parameter in learning.object_field.light_head.parameters():
            parameter.fill_(float("nan"))
    with pytest.raises(LearningError, match="not finite"):
        for _ in range(100):
            learning.learn_step()


@pytest.mark.parametrize(
    "ablation",
    [
        {"decomposition": False},
        {"dynamic_weight": "paper"},
        {"dynamic_weight": "scaled"},
        {"curvature": 0.0},
        {"background_steps": 0},
    ],
)
def test_ablations_of_the_object_field_learn(rays, ablation):
    learning = FieldsLearning(rays, brief_preset(**{"background_steps": 2, **ablation}), 0, CPU)
    losses = [learning.learn_step() for _ in range(20)]
    assert np.isfinite(losses).all() and np.mean(losses[-4:]) < np.mean(losses[2:6])


def test_without_decomposition_the_color_is_one_radiance_of_the_view_direction():
    field = ObjectField(8, 0.6, decomposed=False)
    points = torch.tensor([[0.6, 0, 0]]).expand(2, 3)
    normal = torch.tensor([[1.0, 0, 0]]).expand(2, 3)
    seen = field.appearance(points, normal, torch.tensor([[-1.0, 0, 0], [-0.6, 0.8, 0]]))
    assert (seen.albedo == 1).all() and not torch.equal(seen.color[0], seen.color[1])


def test_the_object_is_looked_for_in_the_pixels_that_show_it(rays):
    learning = FieldsLearning(rays, brief_preset(first_sharpness=100.0), 0, CPU)
    learning._update_object_pixels()
    radius = learning.preset.initial_radius
    origins, directions, _ = rays.rays(torch.cat([rays.sphere.tensor(), rays.outside.tensor()]))
    off_axis = torch.linalg.cross(origins, directions).norm(dim=-1)
    found = torch.zeros(rays.count, dtype=torch.bool)
    found[learning.object_pixels.tensor()] = True
    found = found[torch.cat([rays.sphere.tensor(), rays.outside.tensor()])]
    assert found[off_axis < radius].all() and not found[off_axis > radius + 0.45].any()


@pytest.mark.parametrize(
    ("after", "settled"), [((0.073, 0.071, 0.067, 0.066), False), ((0.073, 0.06, 0.06, 0.06, 0.0599), True)]
)
def test_learning_ends_early_only_where_the_error_stopped_falling_on_the_finest_grid(rays, after, settled):
    learning = FieldsLearning(rays, brief_preset(), 0, CPU)
    whole = learning.steps
    learning.step = learning.background_steps
    learning.validation_errors = [0.09, 0.085, 0.08, 0.075, 0.064, *after]  # the finer grid comes with the fifth check
    assert (learning.steps < whole) == settled


def test_a_sphere_without_an_object_is_refused(rays):
    with pytest.raises(LearningError, match="seems to contain nothing"):
        learn_fields(
            rays,
            brief_preset(steps=4, least_explanation_ratio=1e9),
            seed=0,
            device=CPU,
            progress=no_progress,
            checkpoint=NoCheckpoint(),
        )


@pytest.mark.parametrize("white", [0.4, 3.0])
def test_highlights_count_little_but_never_nothing(white):
    radiance = torch.cat([torch.linspace(0, white, 200), torch.logspace(0, 5, 200)[1:] * white]).double().requires_grad_()
    mapped = tone_map_without_highlights(radiance, white)
    torch.testing.assert_close(mapped[:200], tone_map(radiance[:200]))
    assert (mapped.diff() > 0).all()
    (slope,) = torch.autograd.grad(mapped.sum(), radiance)
    relative = slope * radiance.detach()  # what a highlight e times as bright adds
    torch.testing.assert_close(relative[200:], torch.full_like(relative[200:], HIGHLIGHT))
    assert float(relative[198]) > 5 * HIGHLIGHT
    torch.testing.assert_close(tone_map_without_highlights(radiance, math.inf), tone_map(radiance))


def test_lamps_count_in_full_where_the_object_does_not_hide_them(rays):
    learning = FieldsLearning(rays, brief_preset(), 0, CPU)
    lamp = torch.full((3, 3), 50 * learning.highlight_threshold)
    nothing = torch.zeros(())
    out = Rendering(lamp, torch.tensor([0.0, 0.5, 1.0]), torch.ones(3, 1), nothing, nothing, nothing)
    compared = learning._difference(out, 0.5 * lamp)[:, 0]
    full, dull = float((tone_map(lamp) - tone_map(0.5 * lamp))[0, 0]), HIGHLIGHT * math.log(2)
    torch.testing.assert_close(compared, torch.tensor([full, (full + dull) / 2, dull]))


@pytest.mark.parametrize("cut", [False, True])
def test_white_hangs_on_what_is_shown_and_not_on_black_around_it(rays, masked_rays, cut):
    black = replace(rays, radiance=rays.radiance * (masked_rays.mask > 127)[:, None], mask=masked_rays.mask if cut else None)
    shown = masked_rays.radiance[(masked_rays.mask > 127) & masked_rays.valid]
    found = FieldsLearning(black, brief_preset(), 0, CPU).highlight_threshold / preset("preview").fields.highlight_threshold
    assert found == pytest.approx(float(shown.clamp(min=1e-6).log().mean().exp()), rel=0.15)
    bright = replace(rays, radiance=1000 * rays.radiance)
    assert FieldsLearning(bright, brief_preset(), 0, CPU).highlight_threshold == pytest.approx(
        1000 * FieldsLearning(rays, brief_preset(), 0, CPU).highlight_threshold, rel=1e-3
    )
