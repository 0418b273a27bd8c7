"""f_p in a furnace: in uniform light a white object shines like the light, however often it reflects itself."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh

from blender_nep.geometry.ray_tracing import RayTracer
from blender_nep.shading.incoming_light import IncomingLight
from blender_nep.shading.plenoptic import Material, PlenopticFunction, PlenopticSettings, TerminalRadiance, reflected
from blender_nep.shading.unseen_light import UnseenLight


class UniformLight:
    def __init__(self, coverage=1.0):
        self.coverage = coverage

    def query_cone(self, origins, directions, half_angle):
        return torch.ones_like(origins), torch.full((len(origins),), self.coverage)


class UniformTerminal(TerminalRadiance):
    def forward(self, points):
        return torch.ones_like(points.position)


def white(metallic):
    def materials_at(points):
        n = len(points)
        return Material(torch.ones(n, 3), torch.full((n,), 0.4), torch.full((n,), metallic))

    return materials_at


@pytest.fixture(scope="module")
def two_balls():
    """Two spheres side by side: they see each other."""
    left, right = (trimesh.creation.icosphere(subdivisions=4, radius=0.45).apply_translation([x, 0, 0]) for x in (-0.5, 0.5))
    mesh = trimesh.util.concatenate([left, right])
    return np.asarray(mesh.vertices), np.asarray(mesh.faces), np.asarray(mesh.vertex_normals)


def scene(two_balls, levels, coverage=1.0, diffuse=8, use_cones=True):
    vertices, faces, normals = two_balls
    f_p = PlenopticFunction(
        RayTracer(vertices, faces),
        normals,
        UniformLight(coverage),
        UniformTerminal(),
        PlenopticSettings(levels=levels, diffuse=diffuse, specular=4, use_cones=use_cones),
        "cpu",
    )
    rng = np.random.default_rng(0)
    face = rng.integers(0, len(faces), 600)
    barycentric = rng.dirichlet([1, 1, 1], 600).astype(np.float32)
    tilt = 0.3 * torch.randn(600, 3, generator=torch.Generator().manual_seed(1))
    view = torch.nn.functional.normalize(torch.from_numpy(f_p.tracer.face_normals[face]) + tilt, dim=-1)
    return f_p, f_p.points(face, barycentric, view)


class RecordingLight(UniformLight):
    def query_cone(self, origins, directions, half_angle):
        self.widest = float(half_angle.max())
        return super().query_cone(origins, directions, half_angle)


@pytest.mark.parametrize("use_cones", [True, False])
def test_without_cones_the_environment_is_asked_for_rays_only(two_balls, use_cones):
    f_p, points = scene(two_balls, 1, use_cones=use_cones)
    f_p = replace(f_p, environment=RecordingLight())
    f_p.outgoing(points, white(0.0), 1, torch.Generator().manual_seed(2))
    assert (f_p.environment.widest > 0.1) == use_cones and (f_p.environment.widest < 0.01) != use_cones


@pytest.mark.parametrize("levels", [1, 2])
@pytest.mark.parametrize(("metallic", "diffuse"), [(0.0, 8), (1.0, 8), (1.0, 0)])  # a metal needs no diffuse cones
def test_white_furnace_with_self_reflection(two_balls, levels, metallic, diffuse):
    f_p, points = scene(two_balls, levels, diffuse=diffuse)
    out = f_p.outgoing(points, white(metallic), 1, torch.Generator().manual_seed(2))
    assert out.mean().item() == pytest.approx(1, abs=0.02)


class HalfSky:
    """A sky of radiance 1, of which photos show what lies below the horizon."""

    def query_cone(self, origins, directions, half_angle):
        generator = torch.Generator().manual_seed(0)
        u = torch.rand(300, 2, generator=generator)
        first = torch.nn.functional.normalize(torch.linalg.cross(directions, directions.roll(1, -1) + 0.1), dim=-1)
        second = torch.linalg.cross(directions, first)
        cosine = 1 - u[:, :1] * (1 - half_angle.cos())
        turn, flat = 2 * math.pi * u[:, 1:], (1 - cosine**2).sqrt()
        around = flat[..., None] * (turn.cos()[..., None] * first + turn.sin()[..., None] * second)
        coverage = ((cosine[..., None] * directions + around)[..., 2] < 0).float().mean(0)
        return coverage[:, None].expand(-1, 3).contiguous(), coverage

    def equirect(self, height):
        shown = (torch.arange(height) >= height // 2).float()[:, None].expand(height, 2 * height)
        return shown[..., None].expand(-1, -1, 3).contiguous(), shown

    def extrapolated(self, height):
        return torch.ones(height, 2 * height, 3)

    def typical_distance(self):
        return math.inf


@pytest.mark.parametrize("half_angle", [0.05, 0.5, 1.2])
def test_field_and_unseen_light_together_are_the_whole_sky(two_balls, half_angle):
    f_p, points = scene(two_balls, 1)
    f_p = replace(f_p, environment=HalfSky(), unseen=UnseenLight.expected_beside(HalfSky(), 32))
    outward = torch.nn.functional.normalize(points.normal + 0.3 * points.view, dim=-1)
    angle = torch.full((len(points),), half_angle)
    traced = f_p.trace(points, outward, angle)
    free = torch.ones(len(points), dtype=torch.bool)
    free[traced.row] = False
    light = traced.radiance + f_p.unseen(points.position, outward, angle) * (1 - traced.coverage)[:, None]
    assert free.any() and ((traced.coverage[free] > 0.2) & (traced.coverage[free] < 0.8)).any()
    torch.testing.assert_close(light[free], torch.ones_like(light[free]), atol=0.02, rtol=0)
    whole = f_p.unseen.completed(*f_p.environment.equirect(16))
    torch.testing.assert_close(whole, torch.ones_like(whole), atol=0.02, rtol=0)


def test_without_indirect_light_the_object_sees_itself_black(two_balls):
    f_p, points = scene(two_balls, 0)
    light = IncomingLight.gathered(
        f_p, points, (0.1, 0.5, 1.0), 32, torch.zeros(len(points)), torch.Generator().manual_seed(3), lambda _: None
    )
    light = light.updated(white(1.0), torch.Generator())
    assert len(light.traced.hit_index) > 0
    assert 0.5 < light.diffuse.mean().item() < 0.99


def test_prefiltered_light_is_exact_in_a_furnace(two_balls):
    f_p, points = scene(two_balls, 1)
    light = IncomingLight.gathered(
        f_p, points, (0.1, 0.3, 0.6, 1.0), 32, torch.zeros(len(points)), torch.Generator().manual_seed(4), lambda _: None
    )
    light = light.updated(white(1.0), torch.Generator().manual_seed(5))
    for roughness in (0.1, 0.2, 0.6, 1.0):
        r = torch.full((len(points),), roughness)
        out = reflected(
            Material(torch.ones(len(points), 3), r, torch.ones(len(points))), light.moments(r), light.diffuse, light.cos_v
        )
        assert out.median().item() == pytest.approx(1, abs=0.01)
    assert torch.allclose(light.diffuse, torch.ones_like(light.diffuse), atol=1e-3)
