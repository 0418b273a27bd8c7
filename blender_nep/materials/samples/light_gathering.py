"""Computes what does not change while materials are learned: the photo samples, f_p over the mesh, and the light on them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import torch

from blender_nep.capture.rays.pixel_width import pixel_footprint
from blender_nep.geometry.mesh import Surface
from blender_nep.geometry.ray_tracing import RayTracer
from blender_nep.materials.samples.photo_samples import PhotoSamples, select_samples
from blender_nep.materials.training_progress import TrainingProgress
from blender_nep.optimizers import Adam
from blender_nep.profiling import profiled
from blender_nep.shading.incoming_light import IncomingLight, TracedLight
from blender_nep.shading.light_moments import LightMoments
from blender_nep.shading.photographer import up_of
from blender_nep.shading.plenoptic import Material, PlenopticFunction, PlenopticSettings, SurfacePoints, TerminalRadiance
from blender_nep.shading.smooth_irradiance import IrradianceMean
from blender_nep.support.light import SupportLight

if TYPE_CHECKING:
    from blender_nep.capture.rays.pixel_rays import PixelRays
    from blender_nep.fields.environment.field import EnvironmentField
    from blender_nep.presets import MaterialPreset
    from blender_nep.scene.scene import Scene


@dataclass(frozen=True)
class Observations:
    """The surface, and the photo samples that see it."""

    surface: Surface
    rays: PixelRays
    samples: PhotoSamples
    """The n pixels from which the materials are learned"""
    points: SurfacePoints
    """[n] the points of the surface that the samples see"""
    f_p: PlenopticFunction
    footprint: float
    """Median width of a pixel on the surface, unit frame"""
    up: torch.Tensor | None
    """[3] the direction that is up; None: the object turned"""
    device: torch.device

    @classmethod
    def of(
        cls,
        surface: Surface,
        environment: EnvironmentField,
        scene: Scene,
        preset: MaterialPreset,
        seed: int,
    ) -> Observations:
        """Select the samples and set up f_p. Raises LearningError when no photo shows the surface well enough."""
        rays, device, support = scene.rays, scene.device, scene.support
        tracer = RayTracer(surface.vertices, surface.faces)
        samples = _selected(rays, tracer, surface.normals, preset, np.random.default_rng(seed))
        settings = PlenopticSettings(
            levels=preset.levels,
            diffuse=preset.diffuse_cones,
            specular=preset.specular_cones,
            use_cones=preset.use_cones,
        )
        terminal = TerminalRadiance().to(device)
        support_light = None if support is None else SupportLight.of(support, rays, tracer)
        f_p = PlenopticFunction(tracer, surface.normals, environment, terminal, settings, device, support_light)
        points = f_p.points(samples.face, samples.barycentric, samples.view, rays.motion_in(samples.photo))
        up = up_of(rays.cameras()[1]) if points.motion is None else None
        return cls(surface, rays, samples, points, f_p, pixel_footprint(rays), up, device)


def _selected(
    rays: PixelRays, tracer: RayTracer, normals: np.ndarray, preset: MaterialPreset, generator: np.random.Generator
) -> PhotoSamples:
    """At most `preset.samples` photo samples."""
    return select_samples(rays, tracer, normals, count=preset.samples, least_cosine=preset.least_cosine, generator=generator)


def gathered_light(
    seen: Observations, preset: MaterialPreset, generator: torch.Generator, progress: TrainingProgress
) -> IncomingLight:
    """Learn the terminal MLP and gather the prefiltered light [n samples]. Takes long; raises what `progress` raises.

    A resumed run takes both from the checkpoint. Afterwards `progress.state` holds them, so that checkpoints save them.
    """
    f_p, saved = seen.f_p, progress.checkpoint.load() or {}
    if "light" in saved:
        f_p.terminal.load_state_dict(saved["terminal"])
        traced = TracedLight.from_state(saved["light"], seen.points.position.device)
        light = IncomingLight.of(f_p, seen.points, preset.roughness_levels, traced)
        generator.set_state(saved["generator"])
    else:
        if preset.levels > 0:
            _learn_terminal(seen, preset, generator, progress)
        light = IncomingLight.gathered(
            f_p,
            seen.points,
            preset.roughness_levels,
            preset.irradiance_cones,
            seen.samples.reflection_variance,
            generator,
            lambda share: progress.step(10 + int(60 * share)),
            seen.up,
        )
    progress.state = {
        "terminal": f_p.terminal.state_dict(),
        "light": light.traced.state(),
        "generator": generator.get_state(),
    }
    progress.step(70)
    progress.phase_ended("light")
    return light


@dataclass(frozen=True)
class LitSamples:
    """n photo samples, and the light at the points that they see."""

    samples: PhotoSamples
    light: LightMoments
    known: LightMoments
    """The light without the unseen light"""

    def with_unseen(self, gain: float) -> LitSamples:
        """The same with `gain` times the unseen light."""
        known, light = self.known, self.light
        return replace(
            self,
            light=replace(
                light,
                specular=torch.lerp(known.specular, light.specular, gain),
                diffuse=torch.lerp(known.diffuse, light.diffuse, gain),
            ),
        )


@profiled("light of more samples")
def with_more_samples(
    seen: Observations,
    light: IncomingLight,
    materials_at: Callable[[SurfacePoints], Material],
    preset: MaterialPreset,
    seed: int,
    generator: torch.Generator,
    progress: Callable[[float], None],
) -> LitSamples:
    """The samples of `seen` with their `light`, and about as many more.

    The object reflects light to itself as with `materials_at`, and the unseen light is that of `light`. Its irradiance is a
    mean over neighboring samples, because the few cones of one sample make it noisy. progress(share that is done, 0..1) is
    called after each chunk.
    """
    more = _selected(seen.rays, seen.f_p.tracer, seen.surface.normals, preset, np.random.default_rng([seed, 1]))
    points = seen.f_p.points(more.face, more.barycentric, more.view, seen.rays.motion_in(more.photo))
    how = preset.roughness_levels, preset.irradiance_cones, more.reflection_variance, generator, progress, seen.up
    of_more = IncomingLight.gathered(seen.f_p, points, *how)
    of_more = replace(of_more, photographer=light.photographer).updated(materials_at, generator, light.unseen)
    both = LightMoments.joined(light, of_more)
    known = LightMoments.joined(light.without_unseen(), of_more.without_unseen())
    mean = IrradianceMean.over(SurfacePoints.joined([light.points, points]))
    diffuse = known.diffuse + mean(both.diffuse - known.diffuse)
    return LitSamples(PhotoSamples.joined(seen.samples, more), replace(both, diffuse=diffuse), known)


@profiled("terminal MLP")
def _learn_terminal(
    seen: Observations, preset: MaterialPreset, generator: torch.Generator, progress: TrainingProgress
) -> None:
    """Learn the terminal MLP(x, d): the radiance that the surface point x sends in direction d, as the photos show it."""
    net, steps = seen.f_p.terminal, preset.terminal_steps
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(int(torch.randint(1 << 30, (1,), generator=generator)))
        net.load_state_dict(TerminalRadiance().state_dict())
    optimizer = Adam(net.parameters(), preset.terminal_rate)
    goal = torch.log1p(4 * seen.samples.radiance)
    for k in range(steps):
        batch = torch.randint(len(goal), (preset.terminal_batch,), generator=generator).to(seen.device)
        loss = (net.log_radiance(seen.points[batch]) - goal[batch]).abs().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        if k % 20 == 0:
            progress.loss = loss.item()
            progress.step(int(10 * k / steps))
    progress.phase_ended("terminal")
