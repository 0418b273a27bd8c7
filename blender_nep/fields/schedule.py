"""The schedule of fields learning: numbers that change while the fields are learned. It holds no tensors.

Fields learning first learns F_e alone for `background_steps` steps. If the SDF starts from a visual hull, steps of the
colors alone follow: F_e and the color heads are learned, and the SDF stays as it is. Then both fields are learned together,
and the numbers depend on `fraction`: how much of that learning is done.
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
    """How far the learning is, and the settings that follow from it."""

    preset: FieldsPreset
    background_steps: int
    """Number of steps of F_e alone, the first ones."""
    step: int = 0
    """Number of steps that were taken, of each kind."""
    learned: int = 0
    """Number of steps that could change the SDF, each counted `step_multiplier` times; 0 .. preset.steps."""
    from_hull: bool = False
    """Whether the SDF started from a visual hull. If not, it started from a sphere."""
    validation_errors: list[float] = field(default_factory=list)
    """Photometric errors on held-out pixels so far, the oldest first."""

    @classmethod
    def at_start(cls, preset: FieldsPreset, outside: int, pixels: int) -> Schedule:
        """The schedule before the first step. `outside` of all `pixels` have rays that miss the object's sphere.

        If these are too few, F_e is not learned alone first. Then the visual hull comes from masks, or there is none.
        """
        known = outside >= preset.least_outside * pixels
        return cls(preset, preset.background_steps if known else 0)

    @property
    def learns_background(self) -> bool:
        """Whether the next step is a step of F_e alone."""
        return self.step < self.background_steps

    @property
    def first_step_of_shape(self) -> int:
        """The first step that changes the SDF."""
        return self.background_steps + (self.preset.colors_first_steps if self.from_hull else 0)

    @property
    def learns_shape(self) -> bool:
        """Whether the next step changes the SDF."""
        return self.step >= self.first_step_of_shape

    @property
    def fraction(self) -> float:
        """How much of the learning of both fields is done, 0..1."""
        return self.learned / self.preset.steps

    @property
    def total_steps(self) -> int:
        """Number of all steps, of each kind, as expected now. A start from a sphere and a plateau make it smaller."""
        if self.step <= self.background_steps or not self.learns_shape:
            return self.background_steps + self.preset.colors_first_steps + self.preset.steps
        return self.step + math.ceil((self.preset.steps - self.learned) / self.step_multiplier)

    @property
    def environment_fraction(self) -> float:
        """How much of the learning of F_e is done, 0..1. The steps of F_e alone count, too."""
        return self.step / self.total_steps

    @property
    def plateaued(self) -> bool:
        """Whether the validation error has stopped falling: in the last `patience` checks it fell by less than `least_gain`.

        After a refinement the grid is rough at first. So only errors that were measured after the refinement are compared.
        """
        p, errors = self.preset, self.validation_errors
        if len(errors) <= p.patience:
            return False
        # 1e-6: a check that is due at exactly the fraction of the refinement still sees the coarse grid
        first = math.floor((p.refine_at - p.validate_from) / p.validate_every + 1e-6) + 1
        errors = errors[max(0, first) :]
        return len(errors) > p.patience and min(errors[-p.patience :]) > (1 - p.least_gain) * min(errors[: -p.patience])

    @property
    def step_multiplier(self) -> int:
        """How many steps the next step stands for. On a plateau it stands for more than one.

        On a plateau, only the sharpening and the decay of the learning rates are left; so they are soon over.
        """
        return self.preset.plateau_step_multiplier if self.plateaued else 1

    @property
    def sharpness(self) -> float:
        """NeuS sharpness, 1 / object radius. It rises geometrically until the fraction `sharpness_until`, then it stays."""
        p = self.preset
        start = p.hull_sharpness if self.from_hull else p.first_sharpness
        rise = min(self.fraction / p.sharpness_until, 1.0)
        return start * (p.last_sharpness / start) ** rise

    @property
    def samples(self) -> int:
        """Samples of the object field on each ray."""
        p = self.preset
        return p.first_samples if self.fraction < p.first_samples_until else p.samples

    @property
    def environment_gradient_scale(self) -> float:
        """Scale of F_e's gradients from pixels that may show the object."""
        p = self.preset
        return p.environment_gradient_scale if self.fraction < p.environment_gradient_scale_until else 1.0

    @property
    def curvature_weight(self) -> float:
        """Weight of the curvature loss. It is high at first, and then falls, so that detail can form.

        While the light is still unknown, dents in the surface would otherwise explain the light.
        """
        p = self.preset
        last = p.last_curvature / p.curvature if p.curvature > 0 else 1.0
        return p.curvature * geometric_decay(self.fraction, p.curvature_decay_from, last)

    def _object_field_rate(self, first_step: int, decay_from: float) -> float:
        """Factor of a learning rate of F_o: it warms up from `first_step` on, and decays later."""
        p = self.preset
        warm_up = min(1.0, max(0, self.step - first_step + 1) / p.warm_up_steps)
        return warm_up * geometric_decay(self.fraction, decay_from, p.last_rate)

    @property
    def sdf_rate(self) -> float:
        """Learning rate of the SDF in object radii. It falls as the sharpness rises: a sharp surface needs small steps."""
        p = self.preset
        softer = (p.first_sharpness / self.sharpness) ** p.sdf_rate_sharpness_power
        return p.sdf_rate * self._object_field_rate(self.first_step_of_shape, p.sdf_rate_decay_from) * softer

    @property
    def head_rate(self) -> float:
        """Learning rate of the color heads."""
        p = self.preset
        return p.head_rate * self._object_field_rate(self.background_steps, p.head_rate_decay_from)

    @property
    def validation_due(self) -> bool:
        """Whether the validation error must be measured now: from `validate_from` on, every `validate_every` of the
        fraction."""
        p = self.preset
        return self.fraction >= p.validate_from + p.validate_every * len(self.validation_errors)

    def start_from_hull(self) -> None:
        """Note that the SDF starts from a visual hull. Then the surface starts sharper than that of a sphere, and the colors
        are learned before it."""
        self.from_hull = True

    def advance(self) -> None:
        """Count a step that was taken."""
        if self.learns_shape:
            self.learned = min(self.learned + self.step_multiplier, self.preset.steps)
        self.step += 1

    def state(self) -> dict:
        """How far the learning is, for a checkpoint."""
        return {
            "step": self.step,
            "learned": self.learned,
            "from_hull": self.from_hull,
            "validation_errors": list(self.validation_errors),
        }

    def load(self, state: dict) -> None:
        """Go on from `state`."""
        self.step, self.learned, self.from_hull = state["step"], state["learned"], state["from_hull"]
        self.validation_errors = list(state["validation_errors"])
