"""Stage 1, fields learning: the object field F_o and the environment field F_e, learned jointly from the photos alone
(Sec. 3.2). Masks help where they are given and are never required.

This file holds the steps, and what a checkpoint keeps of them. `schedule` says when what happens, `rendering` renders rays
through both fields, `losses` compares them with the photos, `object_pixels` says which pixels are learned from, and
`visual_hull` gives the SDF its start.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from blender_nep.capture.pixel_rays import PixelRays
from blender_nep.capture.pixel_set import PixelSet
from blender_nep.checkpoints import Checkpoint
from blender_nep.fields import environment_training
from blender_nep.fields.environment_field import EnvironmentField
from blender_nep.fields.explanation import explanation_ratio, require_object
from blender_nep.fields.fields import Fields, FieldsReport, HullReport, new_object_field
from blender_nep.fields.losses import FieldsLosses
from blender_nep.fields.non_finite_monitor import NonFiniteMonitor, usable_gradients, usable_loss
from blender_nep.fields.object_field import ObjectField
from blender_nep.fields.object_pixels import draw_pixels, find_object_pixels, held_out_pixels
from blender_nep.fields.rendering import FieldsRenderer, RayBundle, Rendering, RenderSettings
from blender_nep.fields.schedule import Schedule
from blender_nep.fields.visual_hull import background_silhouettes, carve, mask_silhouettes
from blender_nep.fields.volume_rendering import BAND
from blender_nep.geometry.mesh import Surface
from blender_nep.geometry.ray_tracing import RayTracer
from blender_nep.messages import Message, Part
from blender_nep.presets import Preset
from blender_nep.profiling import profiled, section
from blender_nep.tone_mapping import tone_map


class Optimisers:
    """Adam for each of the three parts that have learning rates of their own: the SDF, the color heads, F_e."""

    def __init__(self, object_field: ObjectField, environment: EnvironmentField, preset: Preset) -> None:
        self._object_field, self._environment, self._preset = object_field, environment, preset.fields
        self.sdf = object_field.shape_optimiser(self._preset.sdf_rate, self._preset.sdf_betas)
        self.heads: torch.optim.Optimizer = torch.optim.Adam(
            object_field.color_parameters(), lr=self._preset.head_rate, betas=self._preset.head_betas, fused=True
        )
        self.environment = environment_training.optimiser(environment)

    @property
    def all(self) -> tuple[torch.optim.Optimizer, ...]:
        """The optimisers of the SDF, of the color heads and of F_e."""
        return self.sdf, self.heads, self.environment

    def restart_sdf(self) -> None:
        """Starts the SDF's optimiser anew, because the SDF has other parameters now."""
        self.sdf = self._object_field.shape_optimiser(self._preset.sdf_rate, self._preset.sdf_betas)

    def restart_environment(self) -> None:
        """Starts F_e's optimiser anew, because F_e has other parameters now."""
        self.environment = environment_training.optimiser(self._environment)

    def set_rates(self, schedule: Schedule) -> None:
        """Gives all optimisers the learning rates that are due."""
        for optimiser, rate in ((self.sdf, schedule.sdf_rate), (self.heads, schedule.head_rate)):
            for group in optimiser.param_groups:
                group["lr"] = rate
        self.set_environment_rate(schedule)

    def set_environment_rate(self, schedule: Schedule) -> None:
        """Gives F_e's optimiser the learning rate that is due."""
        environment_training.set_learning_rate(self.environment, self._environment.preset, schedule.environment_fraction)

    def state(self) -> dict:
        """For a checkpoint."""
        return {name: getattr(self, name).state_dict() for name in ("sdf", "heads", "environment")}

    def load(self, state: dict) -> None:
        """Go on from `state`; the fields have been loaded before."""
        self.restart_sdf()
        self.restart_environment()
        for name, values in state.items():
            getattr(self, name).load_state_dict(values)


class FieldsLearning:
    """Stage 1 under way: fields, optimisers, schedule, and the pixels that are learned from.

    With `object_field` that one is learned, and not the preset's. The seed decides all that is random.
    """

    def __init__(
        self, rays: PixelRays, preset: Preset, seed: int, device: torch.device, object_field: ObjectField | None = None
    ) -> None:
        torch.manual_seed(seed)  # of the color heads
        self.rays, self.preset = rays, preset.fields
        self.generator = torch.Generator(device).manual_seed(seed)
        self.environment = EnvironmentField(preset.environment, environment_training.geometric_mean(rays)).to(device)
        self.losses = FieldsLosses.of(preset, rays)
        self.object_field = object_field or new_object_field(preset, device)
        self.schedule = Schedule.at_start(preset.fields, len(rays.outside), rays.count)
        self._add_levels(self.schedule.levels)
        self.renderer = FieldsRenderer(self.object_field, self.environment, preset.fields)
        self.optimisers = Optimisers(self.object_field, self.environment, preset)
        self.monitor = NonFiniteMonitor()
        self.hull: HullReport | None = None
        """The visual hull that the SDF started from."""
        self.object_pixels = rays.sphere
        """Pixels in which the object is seen; all that see its sphere until this is first found out."""
        self.validation_pixels = rays.sphere[:0]
        """[n] int64: held-out pixels in which the object was seen when this was first found out; none before."""
        self.loss = float("nan")
        """Photometric loss of the last step."""

    @property
    def step(self) -> int:
        """Steps taken."""
        return self.schedule.step

    @property
    def steps(self) -> int:
        """Steps in all, as far as can be told now."""
        return self.schedule.total_steps

    @property
    def fraction(self) -> float:
        """How much of the learning of both fields is done, 0..1."""
        return self.schedule.fraction

    def render(self, index: Tensor, generator: torch.Generator | None = None) -> Rendering:
        """Pixels `index` [n] int64 rendered through both fields as they are now. Without a generator nothing is random."""
        return self._render(RayBundle(*self.rays.rays(index)), generator)

    def _render(self, rays: RayBundle, generator: torch.Generator | None) -> Rendering:
        now = self.schedule
        settings = RenderSettings(now.sharpness, now.samples, now.environment_gradient_scale)
        return self.renderer.render(rays, settings, generator)

    def learn_step(self) -> float:
        """One optimisation step; returns its photometric loss. Raises LearningError when too many were not finite."""
        if self.schedule.learns_background:
            self.loss = self._learn_background_step()
        else:
            self.loss = self._learn_joint_step()
        self.schedule.advance()
        return self.loss

    @profiled("steps of F_e alone")
    def _learn_background_step(self) -> float:
        """A step of F_e alone, from pixels that do not see the object's sphere."""
        p = self.preset
        self._refine_environment()
        index = self._draw(self.rays.outside, p.object_rays + p.sphere_rays + p.outside_rays)
        self.optimisers.set_environment_rate(self.schedule)
        loss = environment_training.learn_step(
            self.environment, self.optimisers.environment, self.rays, index, self.generator
        )
        self.monitor.record(usable_loss(loss))
        return loss

    def _prepare_joint_step(self) -> None:
        """What the schedule wants done before the next step of both fields."""
        now = self.schedule
        if now.joint_learning_begins:
            self.start_from_hull()
        if self.object_field.level_count < now.levels:
            self._add_levels(now.levels)
            self.optimisers.restart_sdf()
        if now.object_pixels_due > now.object_pixels_updates:
            self.update_object_pixels()
            now.object_pixels_updates = now.object_pixels_due
        if now.validation_due:
            now.validation_errors.append(self.validation_error())
        self._refine_environment()

    @profiled("steps of both fields")
    def _learn_joint_step(self) -> float:
        self._prepare_joint_step()
        index = self._draw_batch()
        with section("rays and photo values"):
            rays = RayBundle(*self.rays.rays(index))
            photo = self.rays.photo(index)
        out = self._render(rays, self.generator)
        photometric = self.losses.photometric(out, photo)
        mask = None if self.rays.mask is None else self.rays.mask[index].float() / 255
        loss = self.losses.total(photometric, out, self.schedule.curvature_weight, mask)
        self.optimisers.set_rates(self.schedule)
        optimisers = self.optimisers.all
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
        return float(photometric.detach())

    def _draw(self, pool: PixelSet, count: int) -> Tensor:
        return draw_pixels(pool, count, self.preset.held_out_every, self.generator)

    def _draw_batch(self) -> Tensor:
        """The pixels [n] of a step of both fields."""
        p = self.preset
        pools = (
            (self.object_pixels, p.object_rays),
            (self.rays.sphere, p.sphere_rays),
            (self.rays.outside, p.outside_rays),
        )
        return torch.cat([self._draw(pool, count) for pool, count in pools if len(pool)])

    def _add_levels(self, count: int) -> None:
        while self.object_field.level_count < count:
            self.object_field.add_level()

    def _refine_environment(self) -> None:
        if self.environment.refine(self.schedule.environment_fraction):
            self.optimisers.restart_environment()

    @profiled("visual hull")
    def start_from_hull(self) -> None:
        """Starts the SDF from the visual hull, where the silhouettes show one; otherwise it stays as it is."""
        if self.rays.mask is not None:
            silhouettes = mask_silhouettes(self.rays)
        elif self.schedule.background_steps:
            silhouettes = background_silhouettes(self.environment, self.rays)
        else:
            return
        hull = carve(self.rays, silhouettes, round(2 / self.object_field.cell))
        if hull is None or hull.contrast < self.preset.least_contrast:
            return
        self.hull = HullReport(hull.volume, hull.contrast)
        self.object_field.start_from(torch.from_numpy(hull.sdf).to(self.generator.device))
        self.schedule.start_from_hull()

    def update_object_pixels(self) -> None:
        """Finds out in which pixels the object is seen now. The first time it also chooses the validation pixels."""
        self.object_pixels = find_object_pixels(self.rays, self.object_field.shape(), BAND / self.schedule.sharpness)
        if not self.schedule.object_pixels_updates:
            p = self.preset
            self.validation_pixels = held_out_pixels(self.object_pixels, p.held_out_every, p.validation_pixels)

    @profiled("held-out error")
    @torch.no_grad()
    def validation_error(self) -> float:
        """Mean absolute tone-mapped error of the validation pixels; inf where there are none."""
        if not len(self.validation_pixels):
            return float("inf")
        rendered = self.render(self.validation_pixels).radiance
        return float((tone_map(rendered) - tone_map(self.rays.photo(self.validation_pixels))).abs().mean())

    def explanation_ratio(self, pixels: int | None = None) -> float:
        """See `explanation.explanation_ratio`."""
        return explanation_ratio(self.renderer, self.rays, self.schedule.sharpness, self.generator, pixels)

    def report(self, ratio: float) -> FieldsReport:
        """How it went so far, with the explanation ratio that was found."""
        return FieldsReport(
            steps=self.step,
            of_steps=self.schedule.background_steps + self.preset.steps,
            held_out_error=list(self.schedule.validation_errors),
            loss=self.loss,
            explanation_ratio=ratio,
            steps_not_finite=self.monitor.left_out,
            hull=self.hull,
        )

    def state(self) -> dict:
        """Everything that a resumed run needs."""
        return {
            "schedule": self.schedule.state(),
            "loss": self.loss,
            "levels": self.object_field.level_count,
            "object": self.object_field.state_dict(),
            "environment": self.environment.state_dict(),
            "optimisers": self.optimisers.state(),
            "generator": self.generator.get_state(),
            "object_pixels": self.object_pixels.state(),
            "validation_pixels": self.validation_pixels,
            "hull": None if self.hull is None else {"volume": self.hull.volume, "contrast": self.hull.contrast},
            "monitor": self.monitor.state(),
        }

    def load(self, state: dict) -> None:
        """Go on from `state`."""
        device = self.generator.device
        self.schedule.load(state["schedule"])
        self.loss = state["loss"]
        self._add_levels(state["levels"])
        self.object_field.load_state_dict(state["object"])
        self.environment.load_state_dict(state["environment"])
        self.optimisers.load(state["optimisers"])
        self.generator.set_state(state["generator"])
        self.object_pixels = PixelSet.from_state(state["object_pixels"]).to(device)
        self.validation_pixels = state["validation_pixels"].to(device)
        self.hull = None if state["hull"] is None else HullReport(**state["hull"])
        self.monitor.load(state["monitor"])


def learn_fields(
    rays: PixelRays,
    preset: Preset,
    *,
    seed: int,
    device: torch.device,
    progress: Callable[[int, int, float], None],
    checkpoint: Checkpoint,
    surface: Surface | None = None,
    watch: Callable[[FieldsLearning], None] | None = None,
    object_field: ObjectField | None = None,
) -> Fields:
    """Learns F_o and F_e from the photos (Sec. 3.2). With `surface` (a known mesh in the unit frame) F_e alone, from the
    pixels whose rays miss the mesh. With `object_field` that one is learned, and not the preset's.

    progress(step, steps, loss) is called after every step, and watch(FieldsLearning), which may only look; checkpoint is
    asked whether to save or stop.
    Raises LearningError when the loss diverges or the object's sphere is empty, and Stopped on request.
    """
    if surface is not None:
        background = _pixels_beside(surface, rays)
        environment, report = environment_training.learn_environment(
            rays, background, preset.environment, seed=seed, device=device, progress=progress, checkpoint=checkpoint
        )
        skipped = {"skipped": {str(Part.OBJECT_FIELD): Message("reason.mesh_given").state()}}
        return Fields(None, environment, {**skipped, **report.as_dict()})
    learning = FieldsLearning(rays, preset, seed, device, object_field)
    state = checkpoint.load()
    if state is not None:
        learning.load(state)
    while learning.fraction < 1:
        loss = learning.learn_step()
        progress(learning.step, learning.steps, loss)
        if watch is not None:
            watch(learning)
        environment_training.save_if_due(checkpoint, learning.state)
    ratio = learning.explanation_ratio()
    require_object(ratio, preset.fields.least_explanation_ratio)
    environment_training.freeze(learning.environment, rays, rays.outside if len(rays.outside) else rays.sphere, seed)
    return Fields(learning.object_field, learning.environment, learning.report(ratio).as_dict())


def _pixels_beside(surface: Surface, rays: PixelRays, chunk: int = 1 << 18) -> PixelSet:
    """The valid pixels whose rays miss the mesh."""
    tracer = RayTracer(surface.vertices, surface.faces)
    beside = [rays.outside]
    for index in rays.sphere.split(chunk):
        origins, directions, _ = rays.rays(index)
        hit = tracer.occluded(origins.cpu().numpy(), directions.cpu().numpy())
        beside.append(PixelSet.of(index[torch.from_numpy(~hit).to(index.device)]))
    return PixelSet.joined(beside)
