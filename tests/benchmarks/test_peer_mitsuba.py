"""The peer's conventions against our own: where a texel lies, where a direction of the environment map lies, gradients.

Skipped without Mitsuba, and where it cannot render: an LLVM that it does not like ends the whole process, so another one
tries first.
"""

import importlib
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh
from torch.nn import functional

from blender_nep.capture import PixelRays, load_capture
from blender_nep.geometry.mesh import Surface
from blender_nep.geometry.ray_tracing import RayTracer
from blender_nep.geometry.uv_raster import look_up
from blender_nep.presets import preset
from blender_nep.surface.unwrap import unwrap
from support.paths import SUZANNE_SMALL

pytest.importorskip("mitsuba")
TRY = "import mitsuba as mi; mi.set_variant('llvm_ad_rgb'); mi.render(mi.load_dict(mi.cornell_box()), spp=1).numpy()"
tried = subprocess.run([sys.executable, "-c", TRY], capture_output=True, text=True)
if tried.returncode:
    complaint = tried.stderr.strip().splitlines()[-1:]
    pytest.skip(
        f"Mitsuba itself cannot render here: it needs libLLVM (DRJIT_LIBLLVM_PATH) {complaint}", allow_module_level=True
    )
# our own: what is wrong in it is no reason to skip
peer = importlib.import_module("benchmarks.baselines.inverse_path_tracing")
PeerSettings, PathTracer = peer.PeerSettings, peer.PathTracer

SETTINGS = PeerSettings(levels=(1, 4), environment_rows=8, depth=2, pixels=64, samples=4, samples_grad=4)


@pytest.fixture(scope="module")
def ball() -> Surface:
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=0.6)
    vertices = np.asarray(mesh.vertices)
    return unwrap(Surface(vertices, np.asarray(mesh.faces), vertices / 0.6), preset("preview").surface)


def rays_towards(targets: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    directions = functional.normalize(targets, dim=-1)
    return -3 * directions, directions, torch.full((len(targets),), 1e-4)


def test_a_metal_mirrors_the_texel_that_the_mesh_shows(ball):
    torch.manual_seed(0)
    albedo = 0.2 + 0.6 * torch.rand(16, 16, 3)
    metal, smooth = torch.ones(16, 16), torch.full((16, 16), 0.05)
    rays = rays_towards(torch.randn(400, 3))
    found = PathTracer(ball, SETTINGS).render(albedo, smooth, metal, torch.ones(8, 16, 3), rays, 16, 0)
    tracer = RayTracer(ball.vertices, ball.faces)
    _, face, barycentric = tracer.intersect(rays[0].numpy(), rays[1].numpy())
    # seen from the front a metal reflects its albedo of a white world
    expected = look_up(albedo.numpy(), tracer.interpolate(ball.uv, face, barycentric))
    assert np.abs(found.numpy() - expected).mean() < 0.02
    upside_down = look_up(albedo.numpy()[::-1], tracer.interpolate(ball.uv, face, barycentric))
    assert np.abs(found.numpy() - upside_down).mean() > 0.1


def test_what_photos_show_of_the_world_is_what_the_map_lights(ball):
    rays = PixelRays.from_capture(load_capture(SUZANNE_SMALL), 2500, False)
    everything = torch.arange(rays.count)[rays.valid]
    rows = 32
    light = peer.photographed_environment(rays, everything, rows)
    settings = PeerSettings(levels=(1,), environment_rows=rows, samples=4)
    directions = functional.normalize(torch.randn(300, 3, generator=torch.Generator().manual_seed(0)), dim=-1)
    gray = torch.full((2, 2), 0.5)
    found = PathTracer(ball, settings).render(
        gray[..., None].expand(2, 2, 3), gray, gray, light, (2 * directions, directions, torch.full((300,), 1e-4)), 4, 0
    )
    # every pixel put into the texel around it, here by the nearest of all texels' own directions
    theta = torch.arange(rows) / (rows - 1) * torch.pi
    phi = (torch.arange(2 * rows) + 0.5) / (2 * rows) * 2 * torch.pi
    theta, phi = torch.meshgrid(theta, phi, indexing="ij")
    texels = torch.stack([theta.sin() * phi.sin(), theta.cos(), -theta.sin() * phi.cos()], -1).reshape(-1, 3)
    nearest = light.reshape(-1, 3)[(directions @ texels.T).argmax(1)]
    turned = light.reshape(-1, 3)[(directions * torch.tensor([-1.0, 1, 1]) @ texels.T).argmax(1)]
    assert (found - nearest).abs().mean() < 0.5 * (found - turned).abs().mean()
    seen = rays.rays(everything).directions
    texel = (seen @ texels.T).argmax(1)
    total = torch.zeros(len(texels), 3).index_add(0, texel, rays.radiance[everything].float())
    count = torch.zeros(len(texels)).index_add(0, texel, torch.ones(len(texel)))
    many = (count > 20) & (texels[:, 1].abs() < 0.9)
    assert many.sum() > 100
    difference = (light.reshape(-1, 3)[many] - total[many] / count[many, None]).abs()
    assert difference.median() < 0.05


def test_gradients_are_the_differences_of_the_rendering(ball):
    settings = PeerSettings(levels=(1,), environment_rows=8, samples=256, samples_grad=256)
    tracer = PathTracer(ball, settings)
    torch.manual_seed(0)
    light, rays = 0.2 + torch.rand(8, 16, 3), rays_towards(torch.randn(256, 3))

    def mean(values: torch.Tensor) -> torch.Tensor:
        maps = values.reshape(5, 1, 1).expand(5, 2, 2).permute(1, 2, 0)
        return tracer.render(maps[..., :3], maps[..., 3], maps[..., 4], light, rays, 256, 1).mean()

    at = torch.tensor([0.6, 0.4, 0.3, 0.5, 0.4], requires_grad=True)
    (gradient,) = torch.autograd.grad(mean(at), at)
    for k in (0, 2, 4):
        step = torch.zeros(5).index_fill(0, torch.tensor([k]), 0.1)
        difference = (mean(at.detach() + step) - mean(at.detach() - step)) / 0.2
        assert abs(gradient[k] - difference) < 0.1 * abs(difference) + 0.003


def test_learning_lowers_the_loss_and_starts_gray(ball):
    gray = peer.Textures((1, 4))()
    assert gray[0].shape == (4, 4, 3) and (gray[0] == 0.5).all() and (gray[2] == 0.5).all()
    rays = PixelRays.from_capture(load_capture(SUZANNE_SMALL), 2500, False)
    settings = replace(SETTINGS, samples_grad=2, samples=2)
    short, long = (peer.learn(ball, rays, settings, minutes, 0) for minutes in (0.001, 0.05))
    assert long.albedo.shape == (4, 4, 3) and np.isfinite(long.environment).all()
    assert short.report["steps"] == 1 and long.report["last_loss"] < 0.9 * short.report["last_loss"]
