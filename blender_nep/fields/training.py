"""Stage 1, fields learning: the object field F_o and the environment field F_e, rendered together and learned jointly
from the photos alone (Sec. 3.2).

A ray that meets the object's border, the unit sphere, is rendered in three parts: environment before it, object in it,
environment behind it. Masks help where they are given and are never required.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch.nn import functional

from blender_nep.capture.pixel_rays import PixelRays
from blender_nep.capture.pixel_set import GrowingPixelSet, PixelSet
from blender_nep.errors import LearningError, Stopped
from blender_nep.fields import environment_training
from blender_nep.fields.environment_field import EnvironmentField
from blender_nep.fields.non_finite_monitor import NonFiniteMonitor, usable_gradients, usable_loss
from blender_nep.fields.object_field import Appearance, ObjectField
from blender_nep.fields.visual_hull import background_silhouettes, carve, mask_silhouettes
from blender_nep.fields.volume_rendering import BAND, sphere_interval
from blender_nep.geometry.mesh import Surface
from blender_nep.geometry.ray_tracing import RayTracer
from blender_nep.messages import Message, Part
from blender_nep.presets import Preset
from blender_nep.profiling import profiled, section
from blender_nep.tone_mapping import tone_map, tone_map_without_highlights

HELD_OUT = 101
"""Pixels whose index is a multiple of this are not learned from."""


@dataclass
class Fields:
    """What stage 1 has learned. `object_field` is None when a mesh was given and F_e was learned alone."""

    object_field: ObjectField | None
    environment: EnvironmentField
    report: dict

    def state(self) -> dict:
        """As a dict of tensors and numbers, for the disk."""
        objects = None
        if self.object_field is not None:
            objects = {"levels": len(self.object_field.levels), "weights": self.object_field.state_dict()}
        return {"object": objects, "environment": self.environment.state_dict(), "report": self.report}

    @classmethod
    def from_state(cls, state: dict, preset: Preset, device: torch.device) -> Fields:
        """The inverse of `state`."""
        environment = EnvironmentField(preset.environment).to(device)
        environment.load_state_dict(state["environment"])
        field = None
        if state["object"] is not None:
            field = _object_field(preset, device)
            for _ in range(state["object"]["levels"] - 1):
                field.add_level()
            field.load_state_dict(state["object"]["weights"])
        return cls(field, environment, state["report"])


def _object_field(preset: Preset, device: torch.device) -> ObjectField:
    p = preset.fields
    return ObjectField(p.coarsest_cells, p.initial_radius, p.head_width, p.decomposition).to(device)


def _brightness(rays: PixelRays, pixels: int = 10_000) -> float:
    """Geometric mean of the radiance around the object, with masks of the object's; black pixels show nothing."""
    index = rays.sphere[:: max(1, len(rays.sphere) // pixels)]
    if rays.mask is not None and (rays.mask[index] > 127).any():
        index = index[rays.mask[index] > 127]
    radiance = rays.photo(index)
    brightness = radiance.mean(-1)
    lit = brightness > 0.01 * brightness.quantile(0.9)
    return float(radiance[lit].clamp(min=1e-6).log().mean().exp()) if lit.any() else 1.0


@dataclass
class Rendering:
    """Rays rendered through both fields: radiance [n, 3], object opacity [n], loss weight [n, 1] (the paper's w_l)."""

    radiance: torch.Tensor
    opacity: torch.Tensor
    weight: torch.Tensor
    eikonal: torch.Tensor
    curvature: torch.Tensor
    foreground_opacity: torch.Tensor
    """mean opacity of F_e between the cameras and the object's sphere"""


def dynamic_weight(appearance: Appearance, kind: str, cap: float = 1.5, epsilon: float = 1e-3) -> torch.Tensor:
    """The paper's w_s (eq. 5) [n, 1]: small where the color differs much from the albedo, as in reflections. Detached:
    else growing |c_o - c_a| would lower the loss.

    `paper`: as printed. `scaled`: the difference in tone-mapped space, relative to the batch's own spread, because as
    printed the weight leaves its cap only where |c_o - c_a| > 0.816. `none`: 1.
    """
    color, albedo = appearance.color.detach(), appearance.albedo.detach()
    if kind == "none":
        return torch.ones_like(color[:, :1])
    if kind == "paper":
        square = ((color - albedo) ** 2).mean(-1, keepdim=True)
    else:
        square = ((tone_map(color) - tone_map(albedo)) ** 2).mean(-1, keepdim=True)
        square = square / square.mean().clamp(min=1e-6)
    return (1 / (square + epsilon)).clamp(max=cap)


class FieldsLearning:
    """The state of stage 1: fields, optimisers, step."""

    def __init__(
        self, rays: PixelRays, preset: Preset, seed: int, device: torch.device, object_field: ObjectField | None = None
    ) -> None:
        torch.manual_seed(seed)
        self.rays, self.preset, self.device = rays, preset.fields, device
        self.generator = torch.Generator(device).manual_seed(seed)
        self.environment = EnvironmentField(preset.environment, environment_training.geometric_mean(rays)).to(device)
        self.highlight_threshold = preset.fields.highlight_threshold * _brightness(rays)
        self.object_field = object_field or _object_field(preset, device)
        preset = preset.fields
        self.step, self.loss = 0, float("nan")
        self.learned = 0
        self.validation_errors: list[float] = []
        self.validation_pixels: torch.Tensor | None = None
        self.monitor, self.report = NonFiniteMonitor(), {}
        # without surroundings there is nothing to learn first; the hull then comes from the masks or not at all
        known = len(rays.outside) >= preset.least_outside * rays.count
        self.background_steps = preset.background_steps if known else 0
        self.start_sharpness = preset.first_sharpness
        self.head_optimiser = torch.optim.Adam(
            self.object_field.color_parameters(), lr=preset.head_rate, betas=(0.9, 0.99), fused=True
        )
        self._set_levels(preset.first_levels)
        self._refine_environment()
        self.object_pixels = rays.sphere
        self.object_pixels_updates = 0

    @property
    def steps(self) -> int:
        """Of F_e alone and of both fields together, as far as can be told."""
        if self.step < self.background_steps:
            return self.background_steps + self.preset.steps
        return self.step + math.ceil((self.preset.steps - self.learned) / self._step_multiplier)

    @property
    def fraction(self) -> float:
        """How much of the learning of both fields is done, 0..1."""
        return self.learned / self.preset.steps

    @property
    def _step_multiplier(self) -> int:
        """Steps that one step stands for: more while the error on held-out pixels does not fall, so that what is left,
        the sharpening and the calming down, is soon over."""
        return 4 if self._plateaued else 1

    @property
    def _learning_rate_decay(self) -> float:
        """Factor of F_o's step sizes: 1, then down to `last_rate`, geometrically."""
        p = self.preset
        return p.last_rate ** max(0.0, (self.fraction - p.slow_from) / (1 - p.slow_from))

    @property
    def _plateaued(self) -> bool:
        p = self.preset
        # a finer grid is rough at first: errors from before it are no measure for those after it
        errors = self.validation_errors[
            max(0, math.floor((p.fine_from - p.object_pixels_at[0]) / p.validate_every + 1e-6) + 1) :
        ]
        return len(errors) > p.patience and min(errors[-p.patience :]) > (1 - p.least_gain) * min(errors[: -p.patience])

    def _set_levels(self, count: int) -> None:
        while self.object_field.level_count < count:
            self.object_field.add_level()
        self.sdf_optimiser = self.object_field.shape_optimiser(self.preset.sdf_rate)

    def _refine_environment(self) -> None:
        if self.environment.refine(self.step / self.steps) or self.step == 0:
            self.environment_optimiser = environment_training.optimiser(self.environment)

    @property
    def sharpness(self) -> float:
        """NeuS sharpness, 1 / unit length, at this step: rises geometrically, then stays."""
        p = self.preset
        rise = min(self.fraction / p.sharpness_until, 1.0)
        return self.start_sharpness * (p.last_sharpness / self.start_sharpness) ** rise

    @profiled("render")
    def render(
        self, origins: torch.Tensor, directions: torch.Tensor, half_angle: torch.Tensor, generator: torch.Generator | None
    ) -> Rendering:
        """Radiance of rays through both fields. All rays [n, 3] may or may not meet the sphere."""
        p = self.preset
        samples = p.first_samples if self.fraction < p.coarse_until else p.samples
        entry, leave = sphere_interval(origins, directions)
        meets = (leave > entry).nonzero()[:, 0]
        near = torch.full_like(entry, p.near)
        infinity = torch.full_like(entry, torch.inf)
        n = len(entry)
        shape = self.object_field.shape()
        surface = shape.render(origins[meets], directions[meets], self.sharpness, samples, generator)
        normal = functional.normalize(surface.gradient, dim=-1, eps=1e-6)
        with section("appearance"):
            appearance = self.object_field.appearance(surface.point, normal, directions[meets[surface.ray]])
        opacity = surface.opacity.clamp(max=1)
        # front parts of all rays (whole rays for those that miss), then back parts where something shows through
        clear = torch.ones(len(meets), device=self.device).index_add(0, surface.ray, -opacity)
        behind = (clear.detach() > p.opaque).nonzero()[:, 0]
        back_ray = meets[behind]
        part = torch.cat([torch.arange(n, device=self.device), back_ray])
        start = torch.cat([near, leave[back_ray]])
        end = torch.cat([torch.where(leave > entry, entry, infinity), infinity[back_ray]])
        radiance, transmittance = self.environment.render(
            origins[part], directions[part], start, end, half_angle[part], generator
        )
        foreground_opacity = (1 - transmittance[:n][meets]).mean() if len(meets) else radiance.sum() * 0
        if self.fraction < p.environment_gradient_scale_until:
            # what other pixels know of the surroundings counts more than what the object would have them be
            share = torch.ones(n, device=self.device).index_fill(0, meets, p.environment_gradient_scale)[part]
            radiance = torch.lerp(radiance.detach(), radiance, share[:, None])
            transmittance = torch.lerp(transmittance.detach(), transmittance, share)
        front, back = radiance[:n], radiance[n:]
        inside = torch.zeros(len(meets), 3, device=self.device)
        inside = inside.index_add(0, surface.ray, opacity[:, None] * appearance.color)
        inside = inside.index_add(0, behind, clear[behind, None] * back)
        total = front.index_add(0, meets, transmittance[:n][meets, None] * inside)
        ray = meets[surface.ray]
        opacities = torch.zeros(n, device=self.device).index_add(0, ray, opacity)
        w_s = dynamic_weight(appearance, p.dynamic_weight if p.decomposition else "none")
        weight = torch.ones(n, 1, device=self.device).index_add(0, ray, opacity.detach()[:, None] * (w_s - 1))
        nothing = total.sum() * 0
        eikonal = ((surface.sdf_gradient.norm(dim=-1) - 1) ** 2).mean() if len(ray) else nothing
        with section("curvature"):
            curvature = (shape.bending(surface.point) + 1).sqrt().mean() if len(ray) and p.curvature > 0 else nothing
        return Rendering(total, opacities, weight, eikonal, curvature, foreground_opacity)

    def _set_environment_rate(self) -> None:
        for group in self.environment_optimiser.param_groups:
            group["lr"] = environment_training.learning_rate(self.environment.preset, self.step / self.steps)

    @profiled("draw pixels")
    def _draw(self, pool: PixelSet, count: int) -> torch.Tensor:
        """About `count` random pixels of the pool, without the held-out ones, unless it has no others."""
        index = pool[torch.randint(len(pool), (count,), generator=self.generator, device=self.device)]
        learned = index[index % HELD_OUT != 0]
        return learned if len(learned) else index

    @profiled("held-out error")
    @torch.no_grad()
    def _validation_error(self, pixels: int = 4096) -> float:
        """Photometric error on held-out pixels in which the object was seen at the first look."""
        if self.validation_pixels is None:
            index = torch.cat([part[part % HELD_OUT == 0] for part in self.object_pixels.split(1 << 20)])
            self.validation_pixels = index[:: max(1, len(index) // pixels)]
        if not len(self.validation_pixels):
            return float("inf")
        out = self.render(*self.rays.rays(self.validation_pixels), None)
        return float((tone_map(out.radiance) - tone_map(self.rays.photo(self.validation_pixels))).abs().mean())

    @profiled("steps of F_e alone")
    def _learn_background_step(self) -> float:
        """A step of F_e alone, from pixels that do not see the object's sphere."""
        p = self.preset
        self._refine_environment()
        index = self._draw(self.rays.outside, p.object_rays + p.sphere_rays + p.outside_rays)
        self._set_environment_rate()
        self.loss = environment_training.learn_step(
            self.environment, self.environment_optimiser, self.rays, index, self.generator
        )
        self.monitor.record(usable_loss(self.loss))
        self.step += 1
        return self.loss

    @profiled("visual hull")
    def _find_hull(self) -> None:
        """Starts the SDF from the visual hull, where the silhouettes show one; else it stays a sphere."""
        p = self.preset
        if self.rays.mask is not None:
            silhouettes = mask_silhouettes(self.rays)
        elif self.background_steps:
            silhouettes = background_silhouettes(self.environment, self.rays)
        else:
            return
        hull = carve(self.rays, silhouettes, round(2 / self.object_field.cell))
        if hull is None or hull.contrast < p.least_contrast:
            return
        self.report["hull"] = {"volume": round(hull.volume, 4), "contrast": round(hull.contrast, 2)}
        self.object_field.start_from(torch.from_numpy(hull.sdf).to(self.device))
        self.start_sharpness = p.hull_sharpness

    @profiled("object pixels")
    @torch.no_grad()
    def _update_object_pixels(self, block: int = 4) -> None:
        """Sets `object_pixels`: the valid pixels in which the object is seen now, and some around them."""
        rays, shape, found = self.rays, self.object_field.shape(), GrowingPixelSet(self.device)
        band = BAND / self.sharpness
        for view, (height, width) in enumerate(rays.size):
            row = torch.arange(0, height, block, device=self.device).add(block // 2).clamp(max=height - 1)
            column = torch.arange(0, width, block, device=self.device).add(block // 2).clamp(max=width - 1)
            index = (rays.offset[view] + row[:, None] * width + column).flatten()
            origins, directions, _ = rays.rays(index)
            seen = shape.near(origins, directions, band).float().reshape(1, 1, len(row), len(column))
            seen = functional.max_pool2d(seen, 3, 1, 1)
            seen = seen[0, 0].repeat_interleave(block, 0)[:height].repeat_interleave(block, 1)[:, :width] > 0
            valid = rays.valid[rays.offset[view] : rays.offset[view + 1]]
            found.add(PixelSet.where(seen.flatten() & valid, rays.offset[view]))
        found = found.finished()
        self.object_pixels = found if len(found) else rays.sphere

    def learn_step(self) -> float:
        """One optimisation step; returns the loss."""
        return self._learn_background_step() if self.step < self.background_steps else self._learn_joint_step()

    def _difference(self, out: Rendering, photo: torch.Tensor) -> torch.Tensor:
        """Of renderings and photos [n, 3], tone-mapped; without highlights as far as the object hides what is behind it: F_e
        keeps its lamps."""
        full = (tone_map(out.radiance) - tone_map(photo)).abs()
        dull = tone_map_without_highlights(out.radiance, self.highlight_threshold) - tone_map_without_highlights(
            photo, self.highlight_threshold
        )
        return torch.lerp(full, dull.abs(), out.opacity.detach()[:, None].clamp(max=1))

    @profiled("steps of both fields")
    def _learn_joint_step(self) -> float:
        p, rays = self.preset, self.rays
        if self.step == self.background_steps:
            self._find_hull()
        if self.fraction >= p.fine_from and self.object_field.level_count < p.last_levels:
            self._set_levels(p.last_levels)
        object_pixels_updates = sum(self.fraction >= fraction for fraction in p.object_pixels_at)
        if object_pixels_updates > self.object_pixels_updates:
            self.object_pixels_updates = object_pixels_updates
            self._update_object_pixels()
        if self.object_pixels_updates and self.fraction >= p.object_pixels_at[0] + p.validate_every * len(
            self.validation_errors
        ):
            self.validation_errors.append(self._validation_error())
        self._refine_environment()
        pick = [
            self._draw(pool, count)
            for pool, count in (
                (self.object_pixels, p.object_rays),
                (rays.sphere, p.sphere_rays),
                (rays.outside, p.outside_rays),
            )
            if len(pool)
        ]
        index = torch.cat(pick)
        with section("rays and photo values"):
            origins, directions, half_angle = rays.rays(index)
            photo = rays.photo(index)
        out = self.render(origins, directions, half_angle, self.generator)
        photometric = (out.weight * self._difference(out, photo)).mean()
        # stiff while the light is still unknown, which would else be explained by dents; then free for detail
        soften = (p.last_curvature / p.curvature if p.curvature > 0 else 1.0) ** max(0.0, 2 * self.fraction - 1)
        loss = photometric + p.eikonal * out.eikonal + p.curvature * soften * out.curvature
        loss = loss + self.environment.preset.foreground_opacity * out.foreground_opacity
        if rays.mask is not None and p.mask > 0:
            mask = rays.mask[index].float() / 255
            loss = loss + p.mask * functional.binary_cross_entropy(out.opacity.clamp(1e-4, 1 - 1e-4), mask)
        warm = min(1.0, (self.step - self.background_steps + 1) / 50) * self._learning_rate_decay
        # a sharper surface answers to smaller steps
        for group in self.sdf_optimiser.param_groups:
            group["lr"] = p.sdf_rate * warm * (p.first_sharpness / self.sharpness) ** 0.5
        for group in self.head_optimiser.param_groups:
            group["lr"] = p.head_rate * warm
        self._set_environment_rate()
        optimisers = (self.sdf_optimiser, self.head_optimiser, self.environment_optimiser)
        for optimiser in optimisers:
            optimiser.zero_grad()
        usable = usable_loss(float(loss.detach()))
        if usable and loss.requires_grad:  # not so where no ray meets anything that is learned
            with section("backward"):
                loss.backward()
            self.environment.regularise(self.generator)
            usable = usable_gradients(optimisers)
        if self.monitor.record(usable):
            with section("optimisers"):
                for optimiser in optimisers:
                    optimiser.step()
        self.step += 1
        self.learned = min(self.learned + self._step_multiplier, p.steps)
        self.loss = float(photometric.detach())
        return self.loss

    @torch.no_grad()
    def explanation_ratio(self, pixels: int = 16384) -> float:
        """How much better the object explains the pixels that it covers than F_e alone would, if it were not there: the
        ratio of their mean tone-mapped errors. Near 1: the sphere is empty. 0 where no pixel is covered."""
        pick = torch.randint(len(self.rays.sphere), (pixels,), generator=self.generator, device=self.device)
        index = self.rays.sphere[pick]
        origins, directions, half_angle = self.rays.rays(index)
        surface = self.object_field.shape().render(origins, directions, self.sharpness, self.preset.samples, None)
        solid = surface.opacity > 0.9
        ray = surface.ray[solid]
        if len(ray) < 0.001 * pixels:
            return 0.0
        normal = functional.normalize(surface.gradient[solid], dim=-1, eps=1e-6)
        color = self.object_field.appearance(surface.point[solid], normal, directions[ray]).color
        near = torch.full((len(ray),), self.preset.near, device=self.device)
        behind, _ = self.environment.render(
            origins[ray], directions[ray], near, torch.full_like(near, torch.inf), half_angle[ray], None
        )
        photo = tone_map(self.rays.photo(index[ray]))
        error = (tone_map(color) - photo).abs().mean().clamp(min=1e-6)
        return float((tone_map(behind) - photo).abs().mean() / error)

    def state(self) -> dict:
        """Everything that a resumed run needs."""
        return {
            "step": self.step,
            "loss": self.loss,
            "levels": self.object_field.level_count,
            "object": self.object_field.state_dict(),
            "environment": self.environment.state_dict(),
            "sdf_optimiser": self.sdf_optimiser.state_dict(),
            "head_optimiser": self.head_optimiser.state_dict(),
            "environment_optimiser": self.environment_optimiser.state_dict(),
            "generator": self.generator.get_state(),
            "object_pixels_updates": self.object_pixels_updates,
            "object_pixels": self.object_pixels.state(),
            "start_sharpness": self.start_sharpness,
            "report": self.report,
            "learned": self.learned,
            "validation_errors": self.validation_errors,
            "validation_pixels": self.validation_pixels,
            "monitor": self.monitor.state(),
        }

    def load(self, state: dict) -> None:
        """Go on from `state`."""
        self.step, self.loss = state["step"], state["loss"]
        self._set_levels(state["levels"])
        self.object_field.load_state_dict(state["object"])
        self.environment.load_state_dict(state["environment"])
        self.environment_optimiser = environment_training.optimiser(self.environment)
        self.sdf_optimiser.load_state_dict(state["sdf_optimiser"])
        self.head_optimiser.load_state_dict(state["head_optimiser"])
        self.environment_optimiser.load_state_dict(state["environment_optimiser"])
        self.generator.set_state(state["generator"])
        self.object_pixels_updates = state["object_pixels_updates"]
        self.object_pixels = PixelSet.from_state(state["object_pixels"]).to(self.device)
        self.start_sharpness, self.report = state["start_sharpness"], state["report"]
        self.learned, self.validation_errors, self.validation_pixels = (
            state["learned"],
            state["validation_errors"],
            state["validation_pixels"],
        )
        self.monitor.load(state["monitor"])


def learn_fields(
    rays: PixelRays,
    preset: Preset,
    *,
    seed: int,
    device: torch.device,
    progress,
    checkpoint,
    surface: Surface | None = None,
    watch=None,
    object_field: ObjectField | None = None,
) -> Fields:
    """Learns F_o and F_e from the photos (Sec. 3.2). With `surface` (a known mesh in the unit frame) F_e alone, from the
    pixels whose rays miss the mesh. With `object_field` that one is learned, and not the preset's.

    progress(step, steps, loss) is called after every step, and watch(FieldsLearning), which may only look; checkpoint is
    asked whether to save or stop.
    Raises LearningError when the loss diverges and Stopped on request.
    """
    if surface is not None:
        background = _pixels_beside(surface, rays)
        environment, report = environment_training.learn_environment(
            rays, background, preset.environment, seed=seed, device=device, progress=progress, checkpoint=checkpoint
        )
        return Fields(
            None, environment, {"skipped": {str(Part.OBJECT_FIELD): Message("reason.mesh_given").state()}, **report}
        )
    learning = FieldsLearning(rays, preset, seed, device, object_field)
    state = checkpoint.load()
    if state is not None:
        learning.load(state)
    while learning.fraction < 1:
        loss = learning.learn_step()
        progress(learning.step, learning.steps, loss)
        if watch is not None:
            watch(learning)
        if checkpoint.stopping or checkpoint.due():
            checkpoint.save(learning.state())
            if checkpoint.stopping:
                raise Stopped("Stopped during fields learning; the checkpoint is written.", "Go on with --resume.")
    explanation_ratio = learning.explanation_ratio()
    if explanation_ratio < preset.fields.least_explanation_ratio:
        raise LearningError(
            f"The object's sphere seems to contain nothing: the surroundings explain its pixels almost as well as an object"
            f" does (ratio {explanation_ratio:.2f}, needed {preset.fields.least_explanation_ratio}).",
            "Set object_center and object_radius in transforms.json so that the sphere holds the object closely.",
        )
    environment_training.freeze(learning.environment, rays, rays.outside if len(rays.outside) else rays.sphere, seed)
    report = {
        "steps": learning.step,
        "of_steps": learning.background_steps + preset.fields.steps,
        "held_out_error": [round(e, 4) for e in learning.validation_errors],
        "loss": learning.loss,
        "explanation_ratio": round(explanation_ratio, 3),
        **learning.monitor.report(),
        **learning.report,
    }
    return Fields(learning.object_field, learning.environment, report)


def _pixels_beside(surface: Surface, rays: PixelRays, chunk: int = 1 << 18) -> PixelSet:
    """The valid pixels whose rays miss the mesh."""
    tracer = RayTracer(surface.vertices, surface.faces)
    beside = [rays.outside]
    for index in rays.sphere.split(chunk):
        origins, directions, _ = rays.rays(index)
        hit = tracer.occluded(origins.cpu().numpy(), directions.cpu().numpy())
        beside.append(PixelSet.of(index[torch.from_numpy(~hit).to(index.device)]))
    return PixelSet.joined(beside)
