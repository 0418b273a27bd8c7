"""A ball in analytic light, its photos by brute-force Monte Carlo, and material learning on them."""

import functools
import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
import trimesh

from blender_nep.capture.rays.pixel_rays import PixelRays
from blender_nep.capture.rays.pixel_width import pixel_width
from blender_nep.capture.rays.ray_bundle import RayBundle
from blender_nep.capture.rays.response_curve import ResponseCurve
from blender_nep.capture.rays.rigid_motions import RigidMotions
from blender_nep.checkpoints import load_state, save_state
from blender_nep.geometry.mesh import Surface
from blender_nep.materials.corrections import Correction, KeptMaterials
from blender_nep.materials.training import learn_materials
from blender_nep.presets import MaterialPreset, SurfacePreset
from blender_nep.scene.scene import Scene
from blender_nep.shading import brdf
from blender_nep.surface.unwrap import unwrap

PRESET = replace(
    MaterialPreset(),
    samples=1200,
    terminal_steps=60,
    unseen_rows=16,
    unseen_steps=20,
    most_texels=256,
    region=0.4,
    candidates=10,
)
RADIUS = 0.7
HALF_ANGLE = 0.004
"""Of a pixel's cone [radians]"""


@functools.cache
def unwrapped_ball() -> Surface:
    """The ball with its UV map, made once in a process. No test may change its arrays, which are read-only."""
    mesh = trimesh.creation.icosphere(subdivisions=4, radius=RADIUS)
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    ball = unwrap(Surface(vertices, faces, vertices / RADIUS), SurfacePreset(atlas_texels=256))
    for values in (ball.vertices, ball.faces, ball.normals, ball.uv):
        values.setflags(write=False)
    return ball


class AnalyticEnvironment:
    """Radiance of a few soft lamps at infinity; cones widen the lamps as a spherical Gaussian's convolution does."""

    def __init__(self):
        generator = torch.Generator().manual_seed(7)
        self.axis = torch.nn.functional.normalize(torch.randn(14, 3, generator=generator), dim=-1)
        self.color = torch.rand(14, 3, generator=generator) * 4 + 0.2
        self.sharpness = torch.linspace(8, 120, 14)

    def query_cone(self, origins, directions, half_angle):
        variance = 1 / self.sharpness + half_angle[:, None] ** 2 / 4
        gain = (1 / self.sharpness) / variance
        lobes = gain * torch.exp((directions @ self.axis.T - 1) / variance)
        return 0.15 + lobes @ self.color, torch.ones(len(directions))

    def equirect(self, height):
        polar = (torch.arange(height) + 0.5) * math.pi / height
        around = math.pi - (torch.arange(2 * height) + 0.5) * math.pi / height
        polar, around = torch.meshgrid(polar, around, indexing="ij")
        direction = torch.stack([polar.sin() * around.cos(), polar.sin() * around.sin(), polar.cos()], -1).reshape(-1, 3)
        angle = torch.full((len(direction),), 0.5 * math.pi / height)
        radiance, coverage = self.query_cone(torch.zeros_like(direction), direction, angle)
        return radiance.reshape(height, 2 * height, 3), coverage.reshape(height, 2 * height)

    def extrapolated(self, height):
        return self.equirect(height)[0]

    def typical_distance(self):
        return math.inf


class HalfSeen(AnalyticEnvironment):
    """The same light, of which no photo shows the upper part: there F_e is black and without coverage."""

    def query_cone(self, origins, directions, half_angle):
        radiance, _ = super().query_cone(origins, directions, half_angle)
        seen = (directions[:, 2] < 0.3).float()
        return radiance * seen[:, None], seen


class Misled(HalfSeen):
    """The same, but F_e holds a bright radiance where no photo shows anything, as it may after its learning."""

    def extrapolated(self, height):
        radiance, seen = self.equirect(height)
        return radiance + 3 * (1 - seen)[..., None]


class Counting(AnalyticEnvironment):
    """The same light, which counts the cones that it is asked for."""

    cones = 0

    def query_cone(self, origins, directions, half_angle):
        self.cones += len(origins)
        return super().query_cone(origins, directions, half_angle)

    def extrapolated(self, height):
        return AnalyticEnvironment().equirect(height)[0]  # needs no cones


@dataclass
class SyntheticRays:
    """The part of PixelRays that material learning uses."""

    radiance: torch.Tensor
    origin: torch.Tensor
    direction: torch.Tensor
    view: torch.Tensor
    mask: None = None
    exposure: float = 1.0
    curve_of_files: ResponseCurve | None = None
    response: ResponseCurve | None = None
    object_gain: torch.Tensor | None = None
    turntable: RigidMotions | None = None

    burnt_out, white, _ends = PixelRays.burnt_out, PixelRays.white, PixelRays._ends

    @property
    def views(self) -> int:
        return int(self.view.max()) + 1

    def camera(self, view):
        return self.origin[self.view == view][0], None

    def cameras(self):
        """The cameras look at the origin, and their tops point up as far as possible: up is z."""
        eye = torch.stack([self.camera(view)[0] for view in range(self.views)])
        back = torch.nn.functional.normalize(eye, dim=-1)
        across = torch.nn.functional.normalize(torch.linalg.cross(torch.tensor([[0.0, 0, 1]]).expand_as(back), back), dim=-1)
        return eye, torch.stack([across, torch.linalg.cross(back, across), back], -1)

    def project(self, view, points):
        """Every point lies in the middle of every frame."""
        return torch.zeros(len(points), 2), torch.ones(len(points), dtype=torch.bool)

    def __post_init__(self):
        self.sphere = torch.arange(len(self.radiance))
        self.brightest = float(self.radiance.max())

    def rays(self, index):
        motion = self.motion_in(self.view[index])
        return RayBundle(self.origin[index], self.direction[index], torch.full((len(index),), HALF_ANGLE), motion)

    def motion_in(self, view):
        return None if self.turntable is None else self.turntable[view]

    def view_of(self, index):
        return self.view[index]

    def photo(self, index):
        radiance = self.radiance[index] if self.response is None else self.response.light(self.radiance[index])
        return radiance if self.object_gain is None else radiance / self.object_gain[self.view[index]][:, None]

    def as_in_files(self, radiance):
        return radiance

    def with_object_gain(self, gain):
        return replace(self, object_gain=gain)

    def with_response(self, response):
        return replace(self, response=response)


class MemoryCheckpoint:
    """Keeps the last state; due at every step where `always`."""

    stopping = False

    def __init__(self, state=None, always=False):
        self.state, self.always = state, always

    def due(self):
        return self.always

    def save(self, state):
        self.state = state

    def keep(self):
        """The state that was saved last is the present one."""

    def load(self):
        return self.state


def make_photos(materials, views=10, side=32, rays=160, environment=None, turntable=None, photographer=None):
    """Photos of the sphere in all of the light; materials(points [n,3]) -> albedo, roughness, metallic.

    `turntable` are the motions of the sphere to the room, where the light stands still; None: the sphere stands still.
    `photographer` takes light from it; None: nobody does.
    """
    environment, generator = environment or AnalyticEnvironment(), torch.Generator().manual_seed(11)
    eye = torch.nn.functional.normalize(torch.randn(views, 3, generator=generator), dim=-1) * 3
    u = (torch.arange(side) + 0.5) / side * 0.5 - 0.25
    x, y = torch.meshgrid(u, u, indexing="ij")
    frame = brdf.frame(torch.nn.functional.normalize(-eye, dim=-1))
    local = torch.nn.functional.normalize(torch.stack([x, y, torch.ones_like(x)], -1).reshape(-1, 3), dim=-1)
    direction = torch.einsum("vij,nj->vni", frame, local).reshape(-1, 3)
    origin = eye.repeat_interleave(side * side, 0)
    along = -(origin * direction).sum(-1)
    squared = along**2 - (origin**2).sum(-1) + RADIUS**2
    hit = squared > 0
    t = along - squared.clamp_min(0).sqrt()
    albedo, roughness, metallic = materials(origin[hit] + direction[hit] * t[hit, None])
    n = len(albedo)
    uniform = torch.rand(n, rays, 2, generator=generator)
    # A pixel shows a piece of the surface, so its rays are spread over it. The whole pixel has the material of its middle.
    eyes = origin[hit][:, None].expand(n, rays, 3)
    across = brdf.frame(direction[hit])[..., :2]
    offset = (torch.rand(n, rays, 2, generator=generator) - 0.5) * pixel_width(HALF_ANGLE)
    spread = torch.nn.functional.normalize(direction[hit][:, None] + torch.einsum("nij,nkj->nki", across, offset), dim=-1)
    along = (eyes * spread).sum(-1)
    t = -along - (along**2 - (eyes**2).sum(-1) + RADIUS**2).clamp_min(0).sqrt()
    f = brdf.frame(torch.nn.functional.normalize(eyes + spread * t[..., None], dim=-1))
    v = torch.einsum("nkij,nki->nkj", f, -spread)

    view = torch.arange(views).repeat_interleave(side * side)

    def incoming(to_light):
        d = torch.einsum("nkij,nkj->nki", f, to_light)
        left = 1.0 if photographer is None else photographer.left(d, -spread)[..., None]
        d = (d if turntable is None else turntable[view[hit]].directions(d)).reshape(-1, 3)
        return left * AnalyticEnvironment.query_cone(environment, d, d, torch.zeros(len(d)))[0].reshape(n, rays, 3)

    # Balance heuristic between the two samplers: an estimator that shares nothing with the cones.
    each = [x[:, None].expand(n, rays, *x.shape[1:]) for x in (albedo, roughness, metallic)]
    alpha = brdf.alpha_of(each[1])
    h, _ = brdf.sample_vndf(v, alpha, uniform)
    total = torch.zeros(n, 3)
    for to_light in (brdf.reflect(v, h), brdf.sample_cosine(uniform.flip(-1))[0]):
        half = torch.nn.functional.normalize(v + to_light, dim=-1)
        pdf = brdf.vndf_pdf(v[..., 2], half[..., 2], alpha) + to_light[..., 2].clamp_min(0) / math.pi
        value = brdf.evaluate(v, to_light, *each) * to_light[..., 2:].clamp_min(0)
        total += (value * incoming(to_light) / pdf[..., None].clamp_min(1e-9)).mean(1)
    radiance = torch.zeros(len(origin), 3)
    radiance[hit] = total
    return SyntheticRays(radiance, origin, direction, view, turntable=turntable)


def lit_scene(photos: SyntheticRays) -> Scene:
    """The scene of these photos. Material learning does not ask for their analysis."""
    return Scene(photos, photos=None)


def learn(ball, photos, preset=PRESET, checkpoint=None, environment=None):
    steps = []
    result = learn_materials(
        ball,
        environment or AnalyticEnvironment(),
        lit_scene(photos),
        preset,
        seed=0,
        progress=lambda step, steps_, loss, **_: steps.append(step),
        checkpoint=checkpoint or MemoryCheckpoint(),
    )
    assert steps == sorted(steps) and steps[-1] == 100
    return result


def constant(albedo, roughness, metallic):
    def materials(points):
        n = len(points)
        return torch.tensor(albedo).expand(n, 3), torch.full((n,), roughness), torch.full((n,), metallic)

    return materials


def check_kept(kept: KeptMaterials, ball: Surface, file: Path, preset: MaterialPreset) -> None:
    """Assert that what is kept of materials gives the same textures when it was written to `file` and read again."""
    save_state(file, kept.state())
    restored = KeptMaterials.from_state(load_state(file))
    wanted = {0: Correction(metallic=1.0, roughness=0.3)}
    for one, other in zip(restored.bake(ball, wanted, preset)[0], kept.bake(ball, wanted, preset)[0], strict=True):
        np.testing.assert_array_equal(one, other)
