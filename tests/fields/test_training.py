"""Stage 1 on the capture in the repository: what is learned, determinism, resume, ablations."""

import math
from copy import deepcopy
from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh

from benchmarks.suite.harness import with_changes
from benchmarks.suite.plan import ABLATIONS, AT_WHITE
from blender_nep.capture import PixelRays, load_capture
from blender_nep.capture.rays.pixel_set import PixelSet
from blender_nep.checkpoints import Checkpoint, NoCheckpoint
from blender_nep.errors import LearningError, Stopped
from blender_nep.fields.explanation import require_object
from blender_nep.fields.fields import Fields, FieldsReport
from blender_nep.fields.object.field import ObjectField
from blender_nep.fields.refinements import carve
from blender_nep.fields.rendering import FieldsRenderer
from blender_nep.fields.training import FieldsLearning, learn_fields
from blender_nep.geometry.mesh import Surface
from blender_nep.geometry.ray_tracing import RayTracer
from blender_nep.scene.scene import Scene
from blender_nep.stop_request import INPUT_CLOSED, StopRequest
from blender_nep.tone_mapping import tone_map
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


def test_a_short_learning_with_masks_comes_nearer_to_the_truth(masked_rays):
    truth = trimesh.load(SUZANNE_SMALL / "gt_mesh.ply", process=False, force="mesh")
    capture = load_capture(SUZANNE_SMALL)
    points = (trimesh.sample.sample_surface(truth, 2000, seed=0)[0] - capture.object_center) / capture.object_radius
    points = torch.from_numpy(points).float()
    chosen = brief_preset(steps=50, object_rays=512, sphere_rays=512, outside_rays=512, least_explanation_ratio=0.0)
    before = FieldsLearning(Scene.of(masked_rays), chosen, 0).object_field.sdf(points).abs().mean()
    learned = learn_fields(Scene.of(masked_rays), chosen, seed=0, progress=no_progress, checkpoint=NoCheckpoint())
    after = learned.object_field.sdf(points).abs().mean()
    assert after < 0.2 * before, f"{before:.4f} -> {after:.4f}"
    copy = Fields.from_state(learned.state(), chosen, CPU)
    torch.testing.assert_close(copy.object_field.sdf(points), learned.object_field.sdf(points))
    direction = torch.nn.functional.normalize(points, dim=-1)
    torch.testing.assert_close(
        copy.environment.query_cone(points * 0, direction, 0.2), learned.environment.query_cone(points * 0, direction, 0.2)
    )


@pytest.mark.parametrize(
    "paint", [pytest.param(-1.0, id="with fine paint"), pytest.param(2.0, id="without", marks=pytest.mark.slow)]
)
def test_a_resumed_run_gives_the_same_fields(masked_rays, rays, paint):
    # masks give a hull, without which there is no fine paint
    rays, chosen = (masked_rays, brief_preset(least_fine_paint=paint)) if paint < 1 else (rays, brief_preset())
    chosen = replace(chosen, fields=replace(chosen.fields, colors_first_steps=4))

    stops = {4: "F_e alone", 6: "before the hull", 8: "colors", 16: "both fields"}
    whole, states = FieldsLearning(Scene.of(rays), chosen, 3), {}
    for step in range(1, 25):
        whole.learn_step()
        if step in stops:
            states[step] = deepcopy(whole.state())  # the run goes on in the tensors of its state
    detail = whole.object_field.albedo_detail
    assert detail.logits.any() if paint < 1 else detail is None
    for stop, learned in stops.items():
        resumed = FieldsLearning(Scene.of(rays), chosen, 3)
        resumed.load(states[stop])
        for _ in range(24 - stop):
            resumed.learn_step()
        assert resumed.step == whole.step and resumed.loss == whole.loss, learned
        for a, b in zip(whole.object_field.parameters(), resumed.object_field.parameters(), strict=True):
            assert torch.equal(a, b), learned
        assert torch.equal(whole.environment.raw, resumed.environment.raw), learned


def test_with_a_mesh_f_e_learns_from_the_pixels_beside_it(rays):
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.7)
    surface = Surface(np.asarray(ball.vertices), np.asarray(ball.faces), np.asarray(ball.vertex_normals))
    chosen = brief_preset()
    chosen = replace(chosen, environment=replace(chosen.environment, steps=5, rays_per_step=256, coverage_rays=1000))
    fields = learn_fields(Scene.of(rays), chosen, seed=0, progress=no_progress, checkpoint=NoCheckpoint(), surface=surface)
    assert fields.object_field is None and "object field" in fields.report["skipped"]
    origins, directions, _ = rays.rays(rays.sphere[:5000])
    hit = RayTracer(surface.vertices, surface.faces).occluded(origins.numpy(), directions.numpy())
    off_axis = torch.linalg.cross(origins, directions).norm(dim=-1).numpy()
    assert (hit[off_axis < 0.68]).all() and not hit[off_axis > 0.7].any()


def test_a_mesh_that_covers_all_pixels_is_refused(rays):
    room = trimesh.creation.icosphere(subdivisions=3, radius=20)
    surface = Surface(np.asarray(room.vertices), np.asarray(room.faces), np.asarray(room.vertex_normals))
    near = replace(rays, outside=PixelSet.of(rays.outside[:0]))
    with pytest.raises(LearningError, match="covers all pixels") as error:
        learn_fields(
            Scene.of(near), brief_preset(), seed=0, progress=no_progress, checkpoint=NoCheckpoint(), surface=surface
        )
    assert "without the floor" in error.value.hint


def test_few_pixels_beside_the_sphere_do_not_decide(rays):
    """Rays beside the sphere decide on F_e's coverage. A few of them would say that hardly any light is known."""
    few = replace(rays, outside=PixelSet.of(rays.outside[:20]))
    assert FieldsLearning(Scene.of(few), brief_preset(), 0).background is few.sphere
    assert FieldsLearning(Scene.of(rays), brief_preset(), 0).background is rays.outside


def test_a_stop_tells_its_reason(rays, tmp_path):
    stop = StopRequest()
    checkpoint = Checkpoint(tmp_path, "fields_learning", stop, warn=pytest.fail)

    def stop_at_once(*_):
        stop.request(INPUT_CLOSED)

    with pytest.raises(Stopped) as stopped:
        learn_fields(Scene.of(rays), brief_preset(), seed=0, progress=stop_at_once, checkpoint=checkpoint)
    assert stopped.value.name == "stopped.input_closed" and stopped.value.values["reason"] == INPUT_CLOSED
    assert checkpoint.path.is_file()


def test_what_is_said_where_no_surface_was_found():
    with pytest.raises(LearningError, match="hardly any pixel shows an opaque surface"):
        require_object(0.0, 1.4)
    with pytest.raises(LearningError, match=r"ratio 1.20, needed 1.4"):
        require_object(1.2, 1.4)
    require_object(1.5, 1.4)


def test_a_loss_that_is_not_finite_is_given_up_with_a_message(rays):
    learning = FieldsLearning(Scene.of(rays), brief_preset(), 0)
    with torch.no_grad():
        for parameter in learning.object_field.light_head.parameters():
            parameter.fill_(float("nan"))
    with pytest.raises(LearningError, match="not finite"):
        for _ in range(100):
            learning.learn_step()


STAGE_1 = {
    name: changes
    for name, changes in ABLATIONS.items()
    if changes and set(changes) <= {"fields", "environment"} and name != AT_WHITE and not name.startswith("without ")
}
"""Ablations of stage 1 alone, as the benchmarks run them. Refinements that are switched off: test_refinements. How bright
burnt-out light is counts after the learning: test_burnt_out_light."""


@pytest.fixture(scope="module")
def unchanged(masked_rays):
    return after(masked_rays, {})


def after(rays, changes: dict, steps: int = 12) -> list[torch.Tensor]:
    """What was learned after some steps, the first six of F_e alone and the others from a visual hull. The threshold is so
    low that some of the few pixels are highlights."""
    learning = FieldsLearning(Scene.of(rays), with_changes(brief_preset(highlight_threshold=0.5), changes), 0)
    for _ in range(steps):
        learning.learn_step()
    return [parameter.detach() for parameter in (*learning.object_field.parameters(), learning.environment.raw)]


def same(one: list[torch.Tensor], other: list[torch.Tensor]) -> bool:
    return all(a.shape == b.shape and torch.equal(a, b) for a, b in zip(one, other, strict=True))


def test_twelve_steps_are_the_same_twice(masked_rays, unchanged):
    assert same(after(masked_rays, {}), unchanged)


@pytest.mark.parametrize("ablation", STAGE_1)
def test_each_ablation_changes_what_is_learned(masked_rays, unchanged, ablation):
    assert not same(after(masked_rays, STAGE_1[ablation]), unchanged)


@pytest.mark.parametrize(
    "ablation",
    [
        {"decomposition": False},
        {"dynamic_weight": True},
        {"curvature": 0.0},
        {"background_steps": 0},
    ],
)
def test_ablations_of_the_object_field_learn(rays, ablation):
    learning = FieldsLearning(Scene.of(rays), brief_preset(**{"background_steps": 2, **ablation}), 0)
    losses = [learning.learn_step() for _ in range(20)]
    assert np.isfinite(losses).all() and np.mean(losses[-4:]) < np.mean(losses[2:6])


@pytest.mark.parametrize("steps", [0, 3])
def test_f_e_is_learned_alone_for_the_steps_of_the_preset(rays, steps):
    learning = FieldsLearning(Scene.of(rays), brief_preset(background_steps=steps), 0)
    before = [p.detach().clone() for p in learning.object_field.parameters()]
    raw = learning.environment.raw.detach().clone()
    for _ in range(steps):
        learning.learn_step()
    assert same(before, list(learning.object_field.parameters()))
    assert torch.equal(raw, learning.environment.raw) == (steps == 0) and learning.fraction == 0
    learning.learn_step()
    assert not same(before, list(learning.object_field.parameters()))
    assert learning.fraction == 1 / 24


@pytest.mark.parametrize(("least_contrast", "from_hull"), [(2.0, True), (math.inf, False)])
def test_the_sdf_starts_from_a_hull_only_where_a_hull_tells_more(masked_rays, least_contrast, from_hull):
    chosen = brief_preset(background_steps=0, coarsest_cells=16, least_contrast=least_contrast)
    learning = FieldsLearning(Scene.of(masked_rays), chosen, 0)
    points = 0.6 * torch.nn.functional.normalize(torch.randn(100, 3, generator=torch.Generator().manual_seed(0)), dim=-1)
    learning.prepare_joint_step()
    is_sphere = bool((learning.object_field.sdf(points).abs() < 0.02).all())
    assert is_sphere != from_hull and ("acted" in learning.refinements.report()["hull"]) == from_hull
    p = learning.preset
    assert learning.schedule.sharpness == (p.hull_sharpness if from_hull else p.first_sharpness)


def test_from_a_hull_the_colors_are_learned_before_the_shape(masked_rays):
    learning = FieldsLearning(Scene.of(masked_rays), brief_preset(background_steps=0, colors_first_steps=3), 0)
    field = learning.object_field
    learning.learn_step()
    assert learning.schedule.from_hull
    for step in range(1, 6):
        shape, colors = ([p.detach().clone() for p in part] for part in (field.levels, field.color_parameters()))
        surroundings = learning.environment.raw.detach().clone()
        learning.learn_step()
        assert same(shape, list(field.levels)) == (step < 3), step
        assert all(level.grad is None for level in field.levels) == (step < 3), "a gradient for nothing takes time"
        assert not same(colors, field.color_parameters()) and not torch.equal(surroundings, learning.environment.raw)


def test_carving_again_takes_what_the_background_explains(rays, monkeypatch):
    """The background differs from the photos only where a ball is seen; the SDF is a sphere around that ball."""

    def shows_a_ball(background, rays, wanted):
        maps = []
        for view, (height, width) in enumerate(rays.size):
            origin, direction, _ = rays.rays(torch.arange(rays.offset[view], rays.offset[view + 1]))
            seen = torch.linalg.cross(origin, direction).norm(dim=-1) < 0.5
            maps.append(0.2 * seen.float().reshape(height, width))
        return maps

    monkeypatch.setattr(carve, "background_silhouettes", shows_a_ball)
    learning = FieldsLearning(Scene.of(rays), brief_preset(), 0)
    way = torch.nn.functional.normalize(torch.randn(200, 3, generator=torch.Generator().manual_seed(0)), dim=-1)
    assert (learning.object_field.sdf(0.55 * way) < 0).all()
    assert carve.Carving((0.5,)).apply(learning).acted
    assert (learning.object_field.sdf(0.55 * way) > 0).float().mean() > 0.95
    assert (learning.object_field.sdf(0.25 * way) < 0).all()


def test_the_environment_is_the_one_of_the_preset(rays):
    preset = with_changes(brief_preset(background_steps=0), {"environment": {"model": "infinite"}})
    assert FieldsLearning(Scene.of(rays), preset, 0).environment.infinite


def test_what_the_schedule_wants_done_is_done(rays):
    """Levels, object pixels, cavities and the validation error, each when it is due."""
    chosen = brief_preset(background_steps=1, steps=12, first_sharpness=100.0, open_cavities_at=0.5)
    learning = FieldsLearning(Scene.of(rays), chosen, 0)
    p, whole = learning.preset, learning.learned_pixels
    assert learning.validation_error() == math.inf, "no pixels have been chosen yet"
    while learning.fraction < 1:
        before = learning.fraction
        learning.learn_step()
        joint = learning.schedule.learned > 0
        assert learning.object_field.level_count == (p.last_levels if joint and before >= p.refine_at else p.first_levels)
        assert (learning.object_pixels is None) != joint and bool(len(learning.validation_pixels)) == joint
        assert bool(learning.schedule.validation_errors) == (joint and before >= p.validate_from)
    passed = {name: record["passed"] for name, record in learning.refinements.state().items()}
    assert (passed["hull"], passed["levels"], passed["carve"]) == (1, 1, 2)
    assert (passed["cavities"], passed["relief"], passed["object_pixels"]) == (1, 1, 4)
    assert len(learning.object_pixels) < len(whole)
    held_out = learning.validation_pixels
    assert (held_out % p.held_out_every == 0).all()
    # the error that is measured is that of what is rendered
    difference = tone_map(learning.render(held_out).radiance) - tone_map(rays.photo(held_out))
    assert learning.validation_error() == pytest.approx(difference.abs().mean().item())


def test_rays_for_clear_pixels_come_first_once_f_e_is_learned(rays, monkeypatch):
    clear_rays, render = [], FieldsRenderer.render

    def spy(renderer, bundle, settings, generator, clear=0):
        clear_rays.append(clear)
        return render(renderer, bundle, settings, generator, clear)

    monkeypatch.setattr(FieldsRenderer, "render", spy)
    brief = brief_preset(background_steps=2, steps=12, first_sharpness=100.0, validate_from=2.0)
    preset = with_changes(brief, {"environment": {"initial_raw_density": -9.0}})  # F_e is clear
    learning = FieldsLearning(Scene.of(rays), preset, 0)
    while learning.fraction < 0.5:
        learning.learn_step()
    assert clear_rays[:3] == [0, 0, 0] and min(clear_rays[3:]) > 200, "at a quarter of the learning F_e is asked first"
    index, clear = learning._draw_batch()
    assert clear > 200 and np.isin(index[:clear], learning.object_pixels.clear.tensor()).all()
    resumed = FieldsLearning(Scene.of(rays), preset, 0)
    resumed.load(deepcopy(learning.state()))
    assert [learning.learn_step() for _ in range(3)] == [resumed.learn_step() for _ in range(3)]


def test_the_report_says_how_it_went_in_plain_values():
    report = FieldsReport(20, 30, [0.123456, 0.1], 0.25, 1.23456, 0, {"hull": {"acted": [0.0]}})
    plain = {"steps": 20, "of_steps": 30, "held_out_error": [0.1235, 0.1], "loss": 0.25, "explanation_ratio": 1.235}
    plain["refinements"] = {"hull": {"acted": [0.0]}}
    assert report.as_dict() == plain
    assert replace(report, steps_not_finite=2).as_dict() == plain | {"steps_not_finite": 2}


def test_without_decomposition_color_is_one_radiance_of_the_view():
    field = ObjectField(8, 0.6, decomposed=False)
    points = torch.tensor([[0.6, 0, 0]]).expand(2, 3)
    normal = torch.tensor([[1.0, 0, 0]]).expand(2, 3)
    seen = field.appearance(points, normal, torch.tensor([[-1.0, 0, 0], [-0.6, 0.8, 0]]))
    assert (seen.albedo == 1).all() and not torch.equal(seen.color[0], seen.color[1])


@pytest.mark.parametrize("least", [-1.0, 2.0])
def test_kept_fields_have_the_fine_paint_that_was_learned(masked_rays, least):
    chosen = brief_preset(least_fine_paint=least, least_explanation_ratio=0.0)
    learned = learn_fields(Scene.of(masked_rays), chosen, seed=0, progress=no_progress, checkpoint=NoCheckpoint())
    assert (learned.object_field.albedo_detail is not None) == (least < 1)
    assert -1 <= learned.report["refinements"]["fine_paint"]["correlation"] <= 1
    copy = Fields.from_state(learned.state(), chosen, CPU).object_field
    points = torch.rand(50, 3) - 0.5
    colors = [field.appearance(points, points, points).color for field in (learned.object_field, copy)]
    assert torch.equal(*colors)


def test_a_sphere_without_an_object_is_refused(rays):
    with pytest.raises(LearningError, match="seems to contain nothing"):
        learn_fields(
            Scene.of(rays),
            brief_preset(steps=4, least_explanation_ratio=1e9),
            seed=0,
            progress=no_progress,
            checkpoint=NoCheckpoint(),
        )


def test_the_first_step_of_a_level_follows_its_cell_width():
    """Adam's first step of an entry with the level's mean square gradient is the learning rate itself."""
    field = ObjectField(16, 0.6)
    field.add_level()
    field.add_level()
    optimizer = field.shape_optimizer(0.01, (0.9, 0.99))
    before = [level.detach().clone() for level in field.levels]
    for level in field.levels:
        level.grad = torch.full_like(level, 3.0)
    optimizer.step()
    steps = [float((old - level).detach().mean()) for old, level in zip(before, field.levels, strict=True)]
    assert steps == pytest.approx([0.04, 0.02, 0.01], rel=1e-4)
