"""Fields learning (stage 1 of the paper): learns the object field F_o and the environment field F_e jointly (Sec. 3.2).

The fields are learned from the photos alone. Masks help if they are given, but they are not required. This file holds the
steps. `stage` holds the state, `schedule` says what the settings of a step are, `rendering` renders rays through both
fields, and `losses` compares the renderings with the photos. What happens between the steps is in `refinements`.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor

from blender_nep.checkpoints import Checkpoint
from blender_nep.fields.environment import training as environment_training
from blender_nep.fields.explanation import explanation_ratio, require_object
from blender_nep.fields.fields import Fields, FieldsReport
from blender_nep.fields.losses import FieldsLosses
from blender_nep.fields.non_finite_monitor import NonFiniteMonitor, usable_gradients, usable_loss
from blender_nep.fields.object.field import ObjectField
from blender_nep.fields.object_pixels import ObjectPixels, pixels_beside
from blender_nep.fields.refinements.catalog import refinements_of
from blender_nep.fields.refinements.driver import RefinementDriver
from blender_nep.fields.stage import StageOne
from blender_nep.geometry.mesh import Surface
from blender_nep.messages import Message, Part
from blender_nep.presets import Preset
from blender_nep.profiling import profiled, section
from blender_nep.scene.scene import Scene
from blender_nep.support.in_photos import support_in_photos
from blender_nep.support.plane import Support
from blender_nep.tone_mapping import tone_map


class FieldsLearning(StageOne):
    """Fields learning: the state, the steps, and the refinements between them."""

    def __init__(self, scene: Scene, preset: Preset, seed: int, object_field: ObjectField | None = None) -> None:
        super().__init__(scene, preset, seed, object_field)
        self.losses = FieldsLosses.of(preset, scene.rays)
        self.refinements = RefinementDriver(refinements_of(self.preset), self.preset.without)
        self.monitor = NonFiniteMonitor()
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
    def fraction(self) -> float:
        """How much of the learning of both fields is done, 0..1."""
        return self.schedule.fraction

    def learn_step(self) -> float:
        """Take one step and return its photometric loss. Raises LearningError when too many steps were not finite."""
        if self.schedule.learns_background:
            self.loss = self._learn_background_step()
        else:
            self.prepare_joint_step()
            self.loss = self._learn_joint_step()
        self.schedule.advance()
        return self.loss

    @profiled("steps of F_e alone")
    def _learn_background_step(self) -> float:
        """Take a step of F_e alone, on pixels whose rays miss the object's sphere."""
        self._refine_environment()
        index = self.draw(self.rays.outside, self.environment.preset.rays_per_step)
        self.optimizers.set_environment_rate(self.schedule)
        loss = environment_training.learn_step(
            self.environment, self.optimizers.environment, self.rays, index, self.generator
        )
        self.monitor.record(usable_loss(loss))
        return loss

    @profiled("refinements")
    def prepare_joint_step(self) -> None:
        """Apply the refinements that are due, measure the validation error if it is due, and set the learning rates."""
        self.refinements.apply_due(self)
        self.hull = self.cell_scores = None
        if len(self.validation_pixels) and self.schedule.validation_due:
            self.schedule.validation_errors.append(self.validation_error())
        self._refine_environment()
        self.optimizers.set_rates(self.schedule)

    @profiled("steps of both fields")
    def _learn_joint_step(self) -> float:
        index, clear = self._draw_batch()
        with section("rays and photo values"):
            rays = self.rays.rays(index)
            photo = self.rays.photo(index)
        out = self.render_rays(rays, self.generator, clear)
        photometric = self.losses.photometric(out, photo)
        mask = None if self.rays.mask is None else self.rays.mask[index].float() / 255
        weights = self.schedule.curvature_weight, self.environment.distortion_cost
        loss = self.losses.total(photometric, out, *weights, mask, self._mask_says(index))
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

    def _draw_batch(self) -> tuple[Tensor, int]:
        """The random pixels [n] int64 of a step of both fields, and how many of the first ones have a clear F_e in front."""
        p = self.preset
        clear, veiled = self.learned_pixels.draw(p.object_rays, p.held_out_every, self.generator)
        pools = ((self.rays.sphere, p.sphere_rays), (self.rays.outside, p.outside_rays))
        others = [self.draw(pool, count) for pool, count in pools if len(pool)]
        return torch.cat([clear, veiled, *others]), len(clear)

    def _refine_environment(self) -> None:
        done = self.schedule.step, self.schedule.environment_fraction
        if environment_training.refine(self.environment, self.rays, self.background, *done):
            self.optimizers.restart("environment")

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
            refinements=self.refinements.report(),
        )

    def state(self) -> dict:
        """Everything that a resumed run needs."""
        return {
            "schedule": self.schedule.state(),
            "loss": self.loss,
            "structure": self.object_field.structure(),
            "object": self.object_field.state_dict(),
            "environment": self.environment.state_dict(),
            "optimizers": self.optimizers.state(),
            "generator": self.generator.get_state(),
            "refinements": self.refinements.state(),
            "object_pixels": None if self.object_pixels is None else self.object_pixels.state(),
            "validation_pixels": self.validation_pixels,
            "hidden_pixels": self.hidden_pixels,
            "monitor": self.monitor.state(),
            "support": None if self.scene.support is None else self.scene.support.state(),
        }

    def load(self, state: dict) -> None:
        """Go on from `state`."""
        device, pixels = self.generator.device, state["object_pixels"]
        self.schedule.load(state["schedule"])
        self.loss = state["loss"]
        self.object_field.grow(state["structure"])
        self.object_field.load_state_dict(state["object"])
        self.environment.load_state_dict(state["environment"])
        self.optimizers.load(state["optimizers"])
        self.generator.set_state(state["generator"])
        self.refinements.load(state["refinements"])
        self.object_pixels = None if pixels is None else ObjectPixels.from_state(pixels, device)
        self.validation_pixels = state["validation_pixels"].to(device)
        self.hidden_pixels = state["hidden_pixels"].to(device)
        self.monitor.load(state["monitor"])
        self.stand_on(None if state["support"] is None else Support.from_state(state["support"]))


def learn_fields(
    scene: Scene,
    preset: Preset,
    *,
    seed: int,
    progress: Callable[[int, int, float], None],
    checkpoint: Checkpoint,
    surface: Surface | None = None,
    watch: Callable[[FieldsLearning], None] | None = None,
    object_field: ObjectField | None = None,
) -> Fields:
    """Learn F_o and F_e from the photos of the scene, on its device (Sec. 3.2).

    With `surface` (a given mesh in the unit frame), only F_e is learned, from the pixels whose rays miss the mesh. If
    `object_field` is given, it is learned; otherwise a new one is made from the preset. progress(step, steps, loss) and
    watch(FieldsLearning) are called after every step; `watch` must not change the learning. The checkpoint says when to save
    or stop. Raises LearningError when too many steps are not finite or the object's sphere is empty, and Stopped on request.
    """
    if surface is not None:
        rays = scene.rays
        background = pixels_beside(surface, rays)
        environment, report = environment_training.learn_environment(
            rays, background, preset.environment, seed=seed, device=scene.device, progress=progress, checkpoint=checkpoint
        )
        skipped = {
            str(Part.OBJECT_FIELD): Message("reason.mesh_given").state(),
            **environment_training.skipped_detail(environment),
        }
        return Fields(None, environment, {"skipped": skipped, **report.as_dict()}, support_in_photos(rays))
    learning = FieldsLearning(scene, preset, seed, object_field)
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
    environment_training.freeze(learning.environment, learning.rays, learning.background, seed)
    skipped = environment_training.skipped_detail(learning.environment)
    learned = {"skipped": skipped, **learning.report(ratio).as_dict()}
    return Fields(learning.object_field, learning.environment, learned, learning.scene.support)
