"""Scene analysis on captures where the answer is known by geometry, and what it leaves out of learning."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh
from PIL import Image

from blender_nep.capture import PixelRays, load_capture
from blender_nep.fields.environment.field import EnvironmentField
from blender_nep.fields.training import FieldsLearning
from blender_nep.geometry.mesh import Surface
from blender_nep.geometry.ray_tracing import RayTracer
from blender_nep.presets import preset
from blender_nep.scene.analysis import Analysis, Plan, seconds_of_cones
from blender_nep.scene.photo_analysis import PhotoAnalysis
from blender_nep.scene.scene import Scene
from blender_nep.scene.surface_analysis import SurfaceAnalysis, self_visibility
from support.ball_stages import ball_surface
from support.captures import CENTER, RADIUS, write_exr

CPU = torch.device("cpu")


def look(tiny, use_masks=True) -> tuple[PhotoAnalysis, PixelRays]:
    rays = PixelRays.from_capture(load_capture(tiny.folder, use_masks=use_masks), 40_000, use_masks, CPU)
    return PhotoAnalysis.of(rays), rays


def codes(found: Analysis) -> list[str]:
    return [line.code for line in found.sentences()]


def test_how_much_of_the_photos_the_sphere_and_the_object_fill(make_capture):
    found, _ = look(make_capture(masks=True, size=96))
    # the outlines of balls in the middle of a photo: discs of f tan(asin(r / distance)) pixels
    focal, sphere, ball = 1.2 * 96, *(math.tan(math.asin(r / 2.5)) for r in (RADIUS, 0.5))
    assert found.sphere_share == pytest.approx(math.pi * (focal * sphere) ** 2 / 96**2, rel=0.02)
    assert found.object_share == pytest.approx((ball / sphere) ** 2, rel=0.03)
    assert found.pixels_across == pytest.approx(2 * focal * RADIUS / 2.5, rel=0.08)
    assert found.photos == 6 and found.masks and found.backdrop
    lines = " ".join(map(str, found.sentences()))
    assert "52 %" in lines and "Masks are there" in lines and "surroundings" in lines


def test_masks_that_are_ignored_are_not_seen(make_capture):
    found, _ = look(make_capture(masks=True), use_masks=False)
    assert not found.masks and found.object_share is None and found.sentences()[1].code == "scene.masks_not_used"


@pytest.mark.parametrize("white", [0, 20])
def test_the_clipped_share_is_that_of_the_object(make_capture, white):
    tiny = make_capture(masks=True, suffix=".png")
    shown = 0
    for frame in tiny.meta["frames"]:
        file = tiny.folder / frame["file_path"]
        photo, mask = np.array(Image.open(file)), np.array(Image.open(tiny.folder / frame["mask_path"]))
        photo[tuple(np.argwhere(mask > 127)[:white].T)] = 255
        photo[0, :3] = 255  # the surroundings may be as bright as they like
        shown += int((mask > 127).sum())
        Image.fromarray(photo).save(file)
    found, _ = look(tiny)
    assert found.clipped == pytest.approx(white * 6 / shown)
    assert ("scene.object_clipped" in codes(found)) == bool(white)


@pytest.mark.parametrize(("top", "clipped"), [(7.0, False), (3.0, True)])
def test_a_high_range_that_was_cut_off_is_seen(make_capture, top, clipped):
    tiny = make_capture(masks=True)
    for n, frame in enumerate(tiny.meta["frames"]):
        photo = np.full((24, 24, 3), 0.4)
        photo[10:14, 10:14] = np.minimum(3.0 + 0.25 * np.arange(16).reshape(4, 4, 1) / (n + 1), top)
        write_exr(tiny.folder / frame["file_path"], photo)
    found, _ = look(tiny)
    assert found.brightest == pytest.approx(min(top, 6.75), rel=0.01)
    assert (found.clipped > 0.05) == clipped and ("scene.high_range" in codes(found)) != clipped


def test_cut_outs_learn_no_environment(make_capture):
    found, rays = look(make_capture(alpha=True, size=48))
    plan = found.plan(preset("preview"))
    assert not found.backdrop and plan.preset.environment.model == "none" and "environment field" in plan.skipped
    assert codes(found)[0] == "scene.cut_outs"
    learning = FieldsLearning(Scene.of(rays), plan.preset, 0)
    before = learning.environment.raw.detach().clone()
    first = learning.object_field.state_dict()["surface_head.0.weight"].clone()
    for _ in range(3):
        assert math.isfinite(learning.learn_step())
    assert torch.equal(learning.environment.raw, before)
    assert not torch.equal(learning.object_field.state_dict()["surface_head.0.weight"], first)


def test_unknown_surroundings_are_black_clear_and_uncovered():
    field = EnvironmentField(replace(preset("preview").environment, model="none"))
    directions = torch.nn.functional.normalize(torch.randn(9, 3, generator=torch.Generator().manual_seed(0)), dim=-1)
    zero = torch.zeros(9)
    field.freeze(directions, directions)
    for far, passed in ((torch.full((9,), 3.0), 1.0), (torch.full((9,), math.inf), 0.0)):
        radiance, transmittance, _ = field.render(directions, directions, zero, far)
        assert (radiance == 0).all() and (transmittance == passed).all()
    radiance, coverage = field.query_cone(0.5 * directions, directions, 0.3)
    assert (radiance == 0).all() and (coverage == 0).all()
    light, seen = field.equirect(8)
    assert light.shape == (8, 16, 3) and (light == 0).all() and (seen == 0).all()


def bowl(opening: float) -> trimesh.Trimesh:
    """The part of a unit sphere below z = opening, turned inwards."""
    ball = trimesh.creation.icosphere(5)
    return trimesh.Trimesh(ball.vertices, ball.faces[ball.triangles_center[:, 2] < opening][:, ::-1], process=False)


@pytest.mark.parametrize("opening", [-0.5, 0.0, 0.6])
def test_a_bowl_sees_itself_as_its_form_factor_says(opening):
    mesh = bowl(opening)
    seen = self_visibility(RayTracer(mesh.vertices, mesh.faces), np.random.default_rng(0))
    # all that does not leave by the opening, a flat disc: 1 - pi (1 - z^2) / (2 pi (1 + z))
    assert seen == pytest.approx((1 + opening) / 2, abs=0.02)


def test_a_convex_body_needs_no_indirect_light_and_a_ring_does(make_capture):
    _, rays = look(make_capture())
    ball, ring = ball_surface(), trimesh.creation.torus(0.6, 0.25)
    ring = Surface(np.asarray(ring.vertices), np.asarray(ring.faces), np.asarray(ring.vertex_normals))
    convex, hollow = (SurfaceAnalysis.of(surface, rays) for surface in (ball, ring))
    assert convex.self_visibility == 0 and codes(convex)[0] == "scene.convex"
    plan = convex.plan(preset("preview"))
    assert plan.preset.material.levels == 0 and "indirect light" in plan.skipped
    assert hollow.self_visibility > 0.05
    plan = hollow.plan(preset("preview"))
    assert plan.preset.material.levels == 1 and set(plan.skipped) == {"second bounces"}
    plan = replace(hollow, self_visibility=0.4).plan(preset("preview"))
    assert plan.preset == preset("preview") and not plan.skipped


def paint(tiny, shade) -> None:
    """Photos of the capture's ball as shade(normal [n,3], reflected [n,3]) -> [n] says."""
    capture = load_capture(tiny.folder)
    for view, frame in zip(capture.views, tiny.meta["frames"], strict=True):
        camera = view.camera
        x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
        local = np.stack([(x - camera.cx) / camera.fl_x, (camera.cy - y) / camera.fl_y, -np.ones_like(x)], -1)
        d = local.reshape(-1, 3) @ camera.camera_to_world[:3, :3].T
        d /= np.linalg.norm(d, axis=1, keepdims=True)
        o = camera.position - CENTER
        along = -(d @ o)
        root = along**2 - o @ o + 0.5**2
        hit = root > 0
        n = (o + d[hit] * (along[hit] - np.sqrt(root[hit]))[:, None]) / 0.5
        photo = np.full((len(d), 3), 0.2)
        photo[hit] = shade(n, d[hit] - 2 * (d[hit] * n).sum(1, keepdims=True) * n)[:, None]
        write_exr(tiny.folder / frame["file_path"], photo.reshape(camera.height, camera.width, 3))


@pytest.mark.parametrize("matte", [True, False])
def test_chalk_and_mirror_are_told_apart(make_capture, matte):
    tiny = make_capture(views=16, size=64)
    paint(tiny, lambda n, r: 0.5 + 0.3 * (n if matte else r)[:, 0])
    _, rays = look(tiny)
    ball = trimesh.creation.icosphere(4, 0.5 / RADIUS)
    vertices = np.asarray(ball.vertices)
    found = SurfaceAnalysis.of(Surface(vertices, np.asarray(ball.faces), vertices * RADIUS / 0.5), rays)
    assert (found.view_dependence < 0.05) if matte else (found.view_dependence > 0.2)
    assert codes(found)[1] == ("scene.matte" if matte else "scene.glossy")


def test_nothing_is_left_out_where_that_is_turned_off(make_capture):
    photos, rays = look(make_capture(alpha=True))
    everything = replace(preset("preview"), skip_needless=False)
    for found in (photos, SurfaceAnalysis.of(ball_surface(), rays)):
        assert found.plan(everything) == Plan(everything, {})


def test_facts_are_plain_and_finite(make_capture):
    photos, rays = look(make_capture())
    facts = [photos.facts(), SurfaceAnalysis.of(ball_surface(), rays).facts()]
    assert json.loads(json.dumps(facts, allow_nan=False)) == facts


def test_known_metal_gathers_no_irradiance_and_saves_as_much(make_capture):
    p = preset("preview")
    metal = replace(p, material=replace(p.material, metallic=(1.0,)))
    photos, _ = look(make_capture())
    plan = photos.plan(metal)
    assert plan.preset.material.irradiance_cones == 0 and set(plan.skipped) == {"irradiance"}
    assert not photos.plan(p).skipped
    cones = len(p.material.roughness_levels) * p.material.specular_cones
    saved = seconds_of_cones(p.material, plan.preset.material, 10.0)
    assert saved == {"irradiance": pytest.approx(10 * p.material.irradiance_cones / cones)}
