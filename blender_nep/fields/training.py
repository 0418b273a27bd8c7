"""Fields learning (stage 1 of the paper): learns the object field F_o and the environment field F_e jointly (Sec. 3.2).

The fields are learned from the photos alone. Masks help if they are given, but they are not required. This file holds the
steps, and the state that a checkpoint saves. `schedule` says when things happen, `rendering` renders rays through both
fields, `losses` compares the renderings with the photos, `object_pixels` chooses the pixels, and `visual_hull` gives the SDF
its start.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict

import numpy as np
import torch
from torch import Tensor

from blender_nep.capture.rays.pixel_rays import PixelRays
from blender_nep.capture.rays.pixel_set import PixelSet
from blender_nep.capture.rays.ray_bundle import RayBundle
from blender_nep.checkpoints import Checkpoint
from blender_nep.fields.environment import training as environment_training
from blender_nep.fields.environment.field import EnvironmentField
from blender_nep.fields.explanation import explanation_ratio, require_object
from blender_nep.fields.field_optimizers import Optimizers
from blender_nep.fields.fields import Fields, FieldsReport, HullReport, new_object_field
from blender_nep.fields.losses import FieldsLosses
from blender_nep.fields.non_finite_monitor import NonFiniteMonitor, usable_gradients, usable_loss
from blender_nep.fields.object.field import ObjectField
from blender_nep.fields.object.volume_rendering import BAND
from blender_nep.fields.refinements import object_pixels
from blender_nep.fields.refinements.cavities import open_cavities
from blender_nep.fields.refinements.fine_paint import fine_paint
from blender_nep.fields.refinements.hidden_object import hidden_pixels
from blender_nep.fields.refinements.object_pixels import (
    ObjectPixels,
    draw_pixels,
    find_object_pixels,
    held_out_pixels,
    pixels_beside,
)
from blender_nep.fields.refinements.relief import Relief, find_relief
from blender_nep.fields.refinements.visual_hull import (
    VisualHull,
    background_silhouettes,
    carve,
    excess,
    mask_silhouettes,
    score_cells,
)
from blender_nep.fields.rendering import FieldsRenderer, Rendering, RenderSettings
from blender_nep.fields.schedule import Schedule
from blender_nep.geometry.mesh import Surface
from blender_nep.messages import Message, Part
from blender_nep.presets import Preset
from blender_nep.profiling import profiled, section
from blender_nep.support.foot import with_closed_foot
from blender_nep.support.plain_support import find_plain_support
from blender_nep.support.plane import Support
from blender_nep.support.search import find_support_by_photos
from blender_nep.support.texture import SupportColors
from blender_nep.tone_mapping import tone_map

_CARVINGS, _LEAST_CARVED = 8, 0.02
"""With the colors of the support plane, the visual hull is carved up to so many times, as long as it loses this share of its
volume."""


class FieldsLearning:
    """The state of fields learning: fields, optimizers, schedule, and the pixels from which they are learned.

    If `object_field` is given, it is learned; otherwise a new one is made from the preset. The seed decides all random
    numbers.
    """

    def __init__(
        self, rays: PixelRays, preset: Preset, seed: int, device: torch.device, object_field: ObjectField | None = None
    ) -> None:
        torch.manual_seed(seed)  # for the color heads
        self.rays, self.preset = rays, object_pixels.fitted_to_widths(preset.fields, rays)
        self.generator = torch.Generator(device).manual_seed(seed)
        self.environment = EnvironmentField(preset.environment, environment_training.geometric_mean(rays)).to(device)
        self.losses = FieldsLosses.of(preset, rays)
        self.object_field = object_field or new_object_field(preset, device)
        self.schedule = Schedule.at_start(preset.fields, len(rays.outside), rays.count)
        self.object_field.add_levels(self.schedule.levels)
        self.renderer = FieldsRenderer(self.object_field, self.environment, preset.fields)
        self.optimizers = Optimizers(self.object_field, self.environment, preset)
        self.monitor = NonFiniteMonitor()
        self.hull: HullReport | None = None
        """The visual hull from which the SDF started, or None."""
        self.relief: Relief | None = None
        """The relief that was found last; None if none was found."""
        self.fine_paint: float | None = None
        """How far photos from above and from below agree on fine colors of the hull; None without a hull."""
        self.object_pixels = ObjectPixels(rays.sphere.empty(), rays.sphere)
        """The object pixels. Until they are first found, all pixels that see the object's sphere."""
        self.validation_pixels = rays.sphere[:0]
        """[n] int64: held-out pixels among the object pixels. Empty until the object pixels are first found."""
        self.hidden_pixels = rays.sphere[:0]
        """[m] int64, rising: pixels whose masks do not show the object because something stands before it."""
        self.loss = float("nan")
        """Photometric loss of the last step."""

    @property
    def step(self) -> int:
        """Number of steps that were taken."""
        return self.schedule.step

    @property
    def steps(self) -> int:
        """Number of all steps, as expected now."""
        return self.schedule.total_steps

    @property
    def background(self) -> PixelSet:
        """The pixels whose rays miss the object's sphere. If they are too few to learn F_e from, all pixels that see it."""
        enough = len(self.rays.outside) >= self.preset.least_outside * self.rays.count
        return self.rays.outside if enough else self.rays.sphere

    @property
    def fraction(self) -> float:
        """How much of the learning of both fields is done, 0..1."""
        return self.schedule.fraction

    def render(self, index: Tensor, generator: torch.Generator | None = None) -> Rendering:
        """Render the pixels `index` [n] int64 through both fields in their present state. Without a generator, nothing is
        random."""
        return self._render(self.rays.rays(index), generator)

    def _render(self, rays: RayBundle, generator: torch.Generator | None, clear_rays: int = 0) -> Rendering:
        now = self.schedule
        settings = RenderSettings(now.sharpness, now.samples, now.environment_gradient_scale)
        return self.renderer.render(rays, settings, generator, clear_rays)

    def learn_step(self) -> float:
        """Take one step and return its photometric loss. Raises LearningError when too many steps were not finite."""
        if self.schedule.learns_background:
            self.loss = self._learn_background_step()
        else:
            self.loss = self._learn_joint_step()
        self.schedule.advance()
        return self.loss

    @profiled("steps of F_e alone")
    def _learn_background_step(self) -> float:
        """Take a step of F_e alone, on pixels whose rays miss the object's sphere."""
        self._refine_environment()
        index = self._draw(self.rays.outside, self.environment.preset.rays_per_step)
        self.optimizers.set_environment_rate(self.schedule)
        loss = environment_training.learn_step(
            self.environment, self.optimizers.environment, self.rays, index, self.generator
        )
        self.monitor.record(usable_loss(loss))
        return loss

    def _prepare_joint_step(self) -> None:
        """Do what the schedule demands before the next step of both fields."""
        now = self.schedule
        if now.hull_due:
            self.start_from_hull()
        if self.object_field.level_count < now.levels:
            self.object_field.add_levels(now.levels)
            self.optimizers.restart_sdf()
        if now.carvings_due > now.carvings and self.rays.mask is None:
            self.carve_again()
            now.carvings = now.carvings_due
        if now.cavities_due:
            open_cavities(self.object_field, self.rays)
            now.cavities_opened = True
        if now.relief_searches_due > now.relief_searches:
            self.find_relief()
            now.relief_searches = now.relief_searches_due
        if now.object_pixels_due > now.object_pixels_updates:
            self.update_object_pixels()
            now.object_pixels_updates = now.object_pixels_due
        if now.validation_due:
            now.validation_errors.append(self.validation_error())
        self._refine_environment()
        self.optimizers.set_rates(now)

    @profiled("steps of both fields")
    def _learn_joint_step(self) -> float:
        self._prepare_joint_step()
        index, clear = self._draw_batch()
        with section("rays and photo values"):
            rays = self.rays.rays(index)
            photo = self.rays.photo(index)
        out = self._render(rays, self.generator, clear)
        photometric = self.losses.photometric(out, photo)
        mask = None if self.rays.mask is None else self.rays.mask[index].float() / 255
        loss = self.losses.total(photometric, out, self.schedule.curvature_weight, mask, self._mask_says(index))
        optimizers = self.optimizers.all
        for optimizer in optimizers:
            optimizer.zero_grad()
        usable = usable_loss(float(loss.detach()))
        if usable and loss.requires_grad:  # False if no ray meets anything that is learned
            with section("backward"):
                loss.backward()
            self.environment.regularize(self.generator)
            usable = usable_gradients(optimizers)
        if self.monitor.record(usable):
            with section("optimizers"):
                for optimizer in optimizers:
                    optimizer.step()
        return float(photometric.detach())

    def _mask_says(self, index: Tensor) -> Tensor | None:
        """1 [n] where the masks of pixels [n] say something about the object, 0 at hidden pixels; None if there are none."""
        hidden = self.hidden_pixels
        if not len(hidden):
            return None
        return (hidden[torch.searchsorted(hidden, index).clamp(max=len(hidden) - 1)] != index).float()

    def _draw(self, pool: PixelSet, count: int) -> Tensor:
        return draw_pixels(pool, count, self.preset.held_out_every, self.generator)

    def _draw_batch(self) -> tuple[Tensor, int]:
        """The random pixels [n] int64 of a step of both fields, and how many of the first ones have a clear F_e in front."""
        p = self.preset
        clear, veiled = self.object_pixels.draw(p.object_rays, p.held_out_every, self.generator)
        pools = ((self.rays.sphere, p.sphere_rays), (self.rays.outside, p.outside_rays))
        others = [self._draw(pool, count) for pool, count in pools if len(pool)]
        return torch.cat([clear, veiled, *others]), len(clear)

    def _refine_environment(self) -> None:
        if environment_training.refine(self.environment, self.rays, self.background, self.schedule.environment_fraction):
            self.optimizers.restart_environment()

    @profiled("visual hull")
    def start_from_hull(self) -> None:
        """Start the SDF from the visual hull. If the silhouettes show no clear hull, the SDF stays as it is."""
        if self.rays.mask is not None:
            hull = carve(score_cells(self.rays, mask_silhouettes(self.rays), self._cells))
        elif self.schedule.background_steps:
            hull = self.hull_without_masks()
        else:
            return
        if hull is None or hull.contrast < self.preset.least_contrast:
            return
        self.hull = HullReport(hull.volume, hull.contrast)
        if self.rays.mask is not None and self.schedule.background_steps:
            self.hidden_pixels = hidden_pixels(self.rays, hull.sdf, self._unexplained_by_environment())
        sdf, support = hull.sdf, self.object_field.support
        if support is not None:
            sdf = with_closed_foot(sdf, support)
        self.object_field.start_from(torch.from_numpy(sdf).to(self.generator.device))
        self.schedule.start_from_hull()
        self.fine_paint = fine_paint(self.rays, sdf)
        if self.fine_paint >= self.preset.least_fine_paint:
            self.object_field.add_albedo_detail()
            self.optimizers.restart_heads()

    @property
    def _cells(self) -> int:
        """Number of cells of the SDF grid along a side."""
        return round(2 / self.object_field.cell)

    def hull_without_masks(self) -> VisualHull | None:
        """The hull from the residuals of F_e, as it is now. None if F_e explains all.

        If no support plane is known, one is looked for with the hull's help. On a plane, the hull is carved again: with a
        lower threshold, and with the colors of the plane, which F_e does not know.
        """
        score = self._silhouette_scores(self._environment_alone)
        hull, field = carve(score), self.object_field
        if hull is None:
            return None
        if field.support is None:
            field.support = find_plain_support(self.rays, hull.sdf)
        if field.support is None:
            return hull
        return self._hull_on_support(carve(score, on_support=True) or hull, field.support)

    def _hull_on_support(self, hull: VisualHull, support: Support) -> VisualHull:
        """The hull carved with the colors of the support plane, which are known better the smaller the hull is."""
        colors = SupportColors(self.rays, support)
        for _ in range(_CARVINGS):
            background = colors.texture(hull.sdf).before(self._environment_alone)
            carved, before = carve(self._silhouette_scores(background), on_support=True), hull.volume
            if carved is None:  # no usable hull would be left: the colors are not those of the plane
                break
            hull = carved
            if hull.volume > (1 - _LEAST_CARVED) * before:
                break
        return hull

    def _silhouette_scores(self, background: Callable[[RayBundle], Tensor]) -> np.ndarray:
        return score_cells(self.rays, background_silhouettes(background, self.rays), self._cells)

    def _unexplained_by_environment(self) -> Callable[[Tensor], Tensor]:
        """A function of pixels [k] that gives the error [k] of F_e behind the place of the object.

        That is behind the object's sphere, or from the support plane on. The error is relative to the mean error beside the
        sphere.
        """

        def error(index: Tensor) -> Tensor:
            rays = self.rays.rays(index)
            _, leave, _ = self.object_field.shape().interval(rays.origins, rays.directions)
            start = leave.clamp(min=self.environment.preset.camera_near)
            end = torch.full_like(start, torch.inf)
            with torch.no_grad():
                behind = self.environment.render(rays.origins, rays.directions, start, end, rays.half_angle).radiance
            return (tone_map(behind) - tone_map(self.rays.photo(index))).abs().mean(-1)

        typical = float(error(self._draw(self.rays.outside, self.preset.validation_pixels)).mean())
        return lambda index: error(index) / max(typical, 1e-6)

    @torch.no_grad()
    def _environment_alone(self, rays: RayBundle) -> Tensor:
        """The radiance [n, 3] of F_e alone."""
        near = torch.full_like(rays.half_angle, self.environment.preset.camera_near)
        end = torch.full_like(near, torch.inf)
        return self.environment.render(rays.origins, rays.directions, near, end, rays.half_angle).radiance

    @profiled("visual hull")
    def carve_again(self) -> None:
        """Take from the object what F_e and the support plane alone explain, now that both are known better."""
        field, shape = self.object_field, self.object_field.shape()
        band, sdf = BAND / self.schedule.sharpness, field.sdf_in_cells()
        background: Callable[[RayBundle], Tensor] = self.renderer.background
        if field.support is not None:
            background = SupportColors(self.rays, field.support).texture(sdf).before(background)
        silhouettes = background_silhouettes(
            background, self.rays, wanted=lambda rays: shape.near(rays.origins, rays.directions, band)
        )
        free = excess(self.rays, silhouettes, sdf)
        field.add(torch.from_numpy(free).to(self.generator.device))

    def find_relief(self) -> None:
        """Give the SDF the relief that the photos show, if its grid is too coarse for it (`relief.find_relief`)."""
        found = find_relief(self.object_field, self.rays, self.preset.relief_pixels)
        if found is not None:
            self.relief = found
            self.optimizers.restart_sdf()

    def update_object_pixels(self) -> None:
        """Find the object pixels with the present SDF. Before the first validation, also choose the validation pixels.

        The first time, none of them counts as clear: F_e has not learned yet what stands in front of the object.
        """
        band, shape = BAND / self.schedule.sharpness, self.object_field.shape()
        front = self.renderer.front(shape) if self.schedule.object_pixels_updates else None
        self.object_pixels = find_object_pixels(self.rays, shape, band, front)
        if not self.schedule.validation_errors:
            p = self.preset
            self.validation_pixels = held_out_pixels(self.object_pixels.joined(), p.held_out_every, p.validation_pixels)

    @profiled("held-out error")
    @torch.no_grad()
    def validation_error(self) -> float:
        """Mean absolute tone-mapped error of the validation pixels; infinity if there are none."""
        if not len(self.validation_pixels):
            return float("inf")
        rendered = self.render(self.validation_pixels).radiance
        return float((tone_map(rendered) - tone_map(self.rays.photo(self.validation_pixels))).abs().mean())

    def explanation_ratio(self, pixels: int | None = None) -> float:
        """The explanation ratio in the present state (`explanation.explanation_ratio`)."""
        return explanation_ratio(self.renderer, self.rays, self.schedule.sharpness, self.generator, pixels)

    def report(self, ratio: float) -> FieldsReport:
        """The report on the learning so far; `ratio` is the explanation ratio."""
        return FieldsReport(
            steps=self.step,
            of_steps=self.schedule.first_step_of_shape + self.preset.steps,
            held_out_error=list(self.schedule.validation_errors),
            loss=self.loss,
            explanation_ratio=ratio,
            steps_not_finite=self.monitor.left_out,
            hull=self.hull,
            fine_paint=self.fine_paint,
            hidden_pixels=len(self.hidden_pixels),
            relief=self.relief,
        )

    def state(self) -> dict:
        """Everything that a resumed run needs."""
        return {
            "schedule": self.schedule.state(),
            "loss": self.loss,
            "structure": self.object_field.structure(),
            "fine_paint": self.fine_paint,
            "object": self.object_field.state_dict(),
            "environment": self.environment.state_dict(),
            "optimizers": self.optimizers.state(),
            "generator": self.generator.get_state(),
            "object_pixels": self.object_pixels.state(),
            "validation_pixels": self.validation_pixels,
            "hidden_pixels": self.hidden_pixels,
            "hull": None if self.hull is None else asdict(self.hull),
            "relief": None if self.relief is None else asdict(self.relief),
            "monitor": self.monitor.state(),
            "support": None if self.object_field.support is None else self.object_field.support.state(),
        }

    def load(self, state: dict) -> None:
        """Go on from `state`."""
        device = self.generator.device
        self.schedule.load(state["schedule"])
        self.loss = state["loss"]
        self.object_field.grow(state["structure"])
        self.fine_paint = state["fine_paint"]
        self.object_field.load_state_dict(state["object"])
        self.environment.load_state_dict(state["environment"])
        self.optimizers.load(state["optimizers"])
        self.generator.set_state(state["generator"])
        self.object_pixels = ObjectPixels.from_state(state["object_pixels"], device)
        self.validation_pixels = state["validation_pixels"].to(device)
        self.hidden_pixels = state["hidden_pixels"].to(device)
        self.hull = None if state["hull"] is None else HullReport(**state["hull"])
        self.relief = None if state["relief"] is None else Relief(**state["relief"])
        self.monitor.load(state["monitor"])
        self.object_field.support = None if state["support"] is None else Support.from_state(state["support"])


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
    """Learn F_o and F_e from the photos (Sec. 3.2).

    With `surface` (a given mesh in the unit frame), only F_e is learned, from the pixels whose rays miss the mesh. If
    `object_field` is given, it is learned; otherwise a new one is made from the preset. progress(step, steps, loss) and
    watch(FieldsLearning) are called after every step; `watch` must not change the learning. The checkpoint says when to save
    or stop. Raises LearningError when too many steps are not finite or the object's sphere is empty, and Stopped on request.
    """
    if surface is not None:
        background = pixels_beside(surface, rays)
        environment, report = environment_training.learn_environment(
            rays, background, preset.environment, seed=seed, device=device, progress=progress, checkpoint=checkpoint
        )
        skipped = {
            str(Part.OBJECT_FIELD): Message("reason.mesh_given").state(),
            **environment_training.skipped_detail(environment),
        }
        return Fields(None, environment, {"skipped": skipped, **report.as_dict()}, find_support_by_photos(rays))
    learning = FieldsLearning(rays, preset, seed, device, object_field)
    state = checkpoint.load()
    if state is not None:
        learning.load(state)
    else:
        learning.object_field.support = find_support_by_photos(rays)
    while learning.fraction < 1:
        loss = learning.learn_step()
        progress(learning.step, learning.steps, loss)
        if watch is not None:
            watch(learning)
        environment_training.save_if_due(checkpoint, learning.state)
    ratio = learning.explanation_ratio()
    require_object(ratio, preset.fields.least_explanation_ratio)
    environment_training.freeze(learning.environment, rays, learning.background, seed)
    field = learning.object_field
    skipped = environment_training.skipped_detail(learning.environment)
    return Fields(field, learning.environment, {"skipped": skipped, **learning.report(ratio).as_dict()}, field.support)
