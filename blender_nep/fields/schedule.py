"""The schedule of stage 1: numbers that change while the fields are learned. Nothing here holds a tensor.

Stage 1 first learns F_e alone for `background_steps` steps, and then both fields together. What changes while both are
learned depends on `fraction`, the part of that learning that is done.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from blender_nep.presets import FieldsPreset


def geometric_decay(fraction: float, start: float, last: float) -> float:
    """A factor that is 1 up to the fraction `start` and then falls geometrically, to `last` at the fraction 1."""
    return last ** ((fraction - start) / (1 - start)) if fraction > start else 1.0


@dataclass
class Schedule:
    """How far the learning is, and which settings follow from that."""

    preset: FieldsPreset
    background_steps: int
    """Steps of F_e alone, before both fields are learned together."""
    start_sharpness: float
    """NeuS sharpness from which it rises, 1 / object radius."""
    step: int = 0
    """Steps taken, those of F_e alone included."""
    learned: int = 0
    """Steps of both fields, each counted `step_multiplier` times; 0 .. preset.steps."""
    object_pixels_updates: int = 0
    """How often it was found out in which pixels the object is seen."""
    validation_errors: list[float] = field(default_factory=list)
    """Photometric errors on held-out pixels so far, the oldest first."""

    @classmethod
    def at_start(cls, preset: FieldsPreset, outside: int, pixels: int) -> Schedule:
        """For photos of which `outside` of all `pixels` do not look at the object's sphere.

        Where these are few there are no surroundings to learn first; the visual hull then comes from masks or not at all.
        """
        known = outside >= preset.least_outside * pixels
        return cls(preset, preset.background_steps if known else 0, preset.first_sharpness)

    @property
    def learns_background(self) -> bool:
        """Whether the next step is one of F_e alone."""
        return self.step < self.background_steps

    @property
    def joint_learning_begins(self) -> bool:
        """Whether the next step is the first one of both fields."""
        return self.step == self.background_steps

    @property
    def fraction(self) -> float:
        """How much of the learning of both fields is done, 0..1."""
        return self.learned / self.preset.steps

    @property
    def total_steps(self) -> int:
        """Steps of F_e alone and of both fields together, as far as can be told now."""
        if self.learns_background:
            return self.background_steps + self.preset.steps
        return self.step + math.ceil((self.preset.steps - self.learned) / self.step_multiplier)

    @property
    def environment_fraction(self) -> float:
        """How much of the learning of F_e is done, 0..1: that of F_e alone counts too."""
        return self.step / self.total_steps

    @property
    def plateaued(self) -> bool:
        """Whether the validation error has stopped falling: for `patience` checks it has gained less than `least_gain`.

        A finer grid is rough at first: only errors that were measured after it came are compared with each other.
        """
        p, errors = self.preset, self.validation_errors
        if len(errors) <= p.patience:
            return False
        # 1e-6: a check that is due at the very fraction of the refinement still sees the coarse grid
        first = math.floor((p.refine_at - p.object_pixels_at[0]) / p.validate_every + 1e-6) + 1
        errors = errors[max(0, first) :]
        return len(errors) > p.patience and min(errors[-p.patience :]) > (1 - p.least_gain) * min(errors[: -p.patience])

    @property
    def step_multiplier(self) -> int:
        """How many steps the next one stands for: more on a plateau, so that the sharpening and the decay of the learning
        rates, which are all that is left, are soon over."""
        return self.preset.plateau_step_multiplier if self.plateaued else 1

    @property
    def sharpness(self) -> float:
        """NeuS sharpness, 1 / object radius: rises geometrically until `sharpness_until`, then stays."""
        p = self.preset
        rise = min(self.fraction / p.sharpness_until, 1.0)
        return self.start_sharpness * (p.last_sharpness / self.start_sharpness) ** rise

    @property
    def samples(self) -> int:
        """Samples a ray in the object."""
        p = self.preset
        return p.first_samples if self.fraction < p.first_samples_until else p.samples

    @property
    def levels(self) -> int:
        """Levels of the SDF grid."""
        p = self.preset
        return p.last_levels if self.fraction >= p.refine_at else p.first_levels

    @property
    def environment_gradient_scale(self) -> float:
        """Scale of F_e's gradients from pixels that see the object's sphere."""
        p = self.preset
        return p.environment_gradient_scale if self.fraction < p.environment_gradient_scale_until else 1.0

    @property
    def curvature_weight(self) -> float:
        """Weight of the curvature loss. The SDF is stiff while the light is unknown, which dents would else explain; the
        weight then falls, so that detail can form."""
        p = self.preset
        last = p.last_curvature / p.curvature if p.curvature > 0 else 1.0
        return p.curvature * geometric_decay(self.fraction, p.curvature_decay_from, last)

    @property
    def object_field_rate(self) -> float:
        """Factor of both learning rates of F_o: warm-up from the first step of both fields on, decay later."""
        p = self.preset
        warm_up = min(1.0, (self.step - self.background_steps + 1) / p.warm_up_steps)
        return warm_up * geometric_decay(self.fraction, p.rate_decay_from, p.last_rate)

    @property
    def sdf_rate(self) -> float:
        """Learning rate of the SDF, object radii: a sharper surface answers to smaller steps."""
        p = self.preset
        return p.sdf_rate * self.object_field_rate * (p.first_sharpness / self.sharpness) ** p.sdf_rate_sharpness_power

    @property
    def head_rate(self) -> float:
        """Learning rate of the color heads."""
        return self.preset.head_rate * self.object_field_rate

    @property
    def object_pixels_due(self) -> int:
        """How often it should have been found out by now in which pixels the object is seen."""
        return sum(self.fraction >= at for at in self.preset.object_pixels_at)

    @property
    def validation_due(self) -> bool:
        """Whether the validation error is to be measured: every `validate_every` from the first object pixels on."""
        p = self.preset
        if not self.object_pixels_updates:
            return False
        return self.fraction >= p.object_pixels_at[0] + p.validate_every * len(self.validation_errors)

    def start_from_hull(self) -> None:
        """The SDF starts from a visual hull: its surface may be sharper than that of a sphere."""
        self.start_sharpness = self.preset.hull_sharpness

    def advance(self) -> None:
        """Counts a step that was taken."""
        if not self.learns_background:
            self.learned = min(self.learned + self.step_multiplier, self.preset.steps)
        self.step += 1

    def state(self) -> dict:
        """How far the learning is, for a checkpoint."""
        return {
            "start_sharpness": self.start_sharpness,
            "step": self.step,
            "learned": self.learned,
            "object_pixels_updates": self.object_pixels_updates,
            "validation_errors": list(self.validation_errors),
        }

    def load(self, state: dict) -> None:
        """Go on from `state`."""
        self.start_sharpness = state["start_sharpness"]
        self.step, self.learned = state["step"], state["learned"]
        self.object_pixels_updates = state["object_pixels_updates"]
        self.validation_errors = list(state["validation_errors"])
