"""The light of the table under an object: the photos' colors, also where the object hides them; averaged in wide cones."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh

from blender_nep.capture import PixelRays, load_capture
from blender_nep.geometry.ray_tracing import RayTracer
from blender_nep.shading.plenoptic import PlenopticFunction, PlenopticSettings, TerminalRadiance
from blender_nep.support.light import SupportLight
from blender_nep.support.plane import Support
from blender_nep.support.texture import filled
from support.table_scene import BALL, CENTER, HEIGHT, pattern, write_table_scene

SUPPORT = Support(np.array([0.0, 0.0, 1.0]), HEIGHT)


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    """The light of the table under the ball, and the ball's ray tracer."""
    folder = write_table_scene(tmp_path_factory.mktemp("table") / "capture")
    rays = PixelRays.from_capture(load_capture(folder), 10_000, False, torch.device("cpu"))
    ball = trimesh.creation.icosphere(subdivisions=4, radius=BALL).apply_translation(CENTER)
    tracer = RayTracer(ball.vertices, ball.faces)
    return SupportLight.of(SUPPORT, rays, tracer), tracer, np.asarray(ball.vertex_normals)


def cones(radius, half_angle, n=400):
    """Cones from below the ball's equator down to places at this distance from the point of contact."""
    angle = np.linspace(0, 2 * np.pi, n, endpoint=False)
    target = CENTER * [1, 1, 0] + np.stack([radius * np.cos(angle), radius * np.sin(angle), np.full(n, HEIGHT)], 1)
    origin = target + np.array([0, 0, 0.2])
    tensors = [
        torch.from_numpy(x.astype(np.float32)) for x in (origin, np.tile([0, 0, -1.0], (n, 1)), np.full(n, half_angle))
    ]
    return target, tensors


def test_a_narrow_cone_sees_the_colors_of_the_table(scene):
    target, asked = cones(0.45, 0.01)
    radiance, meets = scene[0].query_cone(*asked)
    assert meets.all()
    assert np.abs(radiance.numpy() - pattern(target)).mean() < 0.02


def test_where_the_object_hides_the_table_it_goes_on_as_around(scene):
    target, asked = cones(0.02, 0.01)
    radiance, meets = scene[0].query_cone(*asked)
    assert meets.all() and torch.isfinite(radiance).all()
    assert np.abs(radiance.numpy() - pattern(target)).mean() < 0.15, "not the ball's green, and not black"


def test_a_wide_cone_averages_and_upward_or_outer_cones_miss(scene):
    light = scene[0]
    wide = light.query_cone(*cones(0.45, 1.2)[1])[0]
    narrow = light.query_cone(*cones(0.45, 0.01)[1])[0]
    assert wide.std(0).mean() < 0.5 * narrow.std(0).mean()
    origins, directions, angle = cones(0.45, 0.01)[1]
    assert not light.query_cone(origins, -directions, angle)[1].any()
    sideways = torch.nn.functional.normalize(directions + torch.tensor([6.0, 0, 0]), dim=-1)
    assert not light.query_cone(origins + torch.tensor([0.4, 0, 0]), sideways, angle)[1].any()


def test_the_table_in_the_sphere_lights_the_object(scene):
    class Nothing:
        def query_cone(self, origins, directions, half_angle):
            return torch.zeros_like(origins), torch.zeros(len(origins))

    light, tracer, normals = scene
    f_p = PlenopticFunction(tracer, normals, Nothing(), TerminalRadiance(), PlenopticSettings(1, 8, 4), "cpu")
    down = torch.tensor([[0.0, 0.0, -1.0]])
    _, face, barycentric = tracer.intersect((CENTER + np.array([[0.3, 0.0, -1.0]])).astype(np.float32), -down.numpy())
    start = f_p.points(face, barycentric, down)
    assert f_p.trace(start, down, torch.tensor([0.05])).coverage == 0
    traced = replace(f_p, support_light=light).trace(start, down, torch.tensor([0.05]))
    assert traced.coverage == 1
    below = np.array([[CENTER[0] + 0.3, 0.0, HEIGHT]])
    np.testing.assert_allclose(traced.radiance.numpy(), pattern(below), atol=0.1)


def test_unknown_texels_take_the_mean_of_their_surroundings():
    known = torch.zeros(8, 8, dtype=torch.bool)
    known[0, 0] = known[7, 7] = True
    grid = torch.full((8, 8, 3), 9.0)
    grid[0, 0], grid[7, 7] = 1.0, 3.0
    out = filled(grid, known)
    assert (out[0, 0] == 1).all() and (out[7, 7] == 3).all()
    assert out.min() >= 1 and out.max() <= 3 and out[0, 1].mean() < 2 < out[7, 6].mean()
