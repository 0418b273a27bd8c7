"""The optimizers of fields learning."""

from __future__ import annotations

from typing import Literal, get_args

from blender_nep.fields.environment import training as environment_training
from blender_nep.fields.environment.field import EnvironmentField
from blender_nep.fields.object.field import ObjectField
from blender_nep.fields.schedule import Schedule
from blender_nep.optimizers import Adam, Optimizer
from blender_nep.presets import Preset

OptimizerName = Literal["sdf", "heads", "environment"]
NAMES: tuple[OptimizerName, ...] = get_args(OptimizerName)


class Optimizers:
    """The Adam optimizers of the SDF, the color heads and F_e. Each of the three has its own learning rate."""

    def __init__(self, object_field: ObjectField, environment: EnvironmentField, preset: Preset) -> None:
        self._object_field, self._environment, self._preset = object_field, environment, preset.fields
        for name in NAMES:
            self.restart(name)

    @property
    def all(self) -> tuple[Optimizer, ...]:
        """The optimizers of the SDF, of the color heads and of F_e."""
        return self.sdf, self.heads, self.environment

    def restart(self, name: OptimizerName) -> None:
        """Make an optimizer anew, after the SDF, the color heads or F_e got new parameters."""
        p = self._preset
        if name == "sdf":
            self.sdf = self._object_field.shape_optimizer(p.sdf_rate, p.sdf_betas)
        elif name == "heads":
            self.heads: Optimizer = Adam(self._object_field.color_parameters(), lr=p.head_rate, betas=p.head_betas)
        else:
            self.environment = environment_training.optimizer(self._environment)

    def set_rates(self, schedule: Schedule) -> None:
        """Set the learning rates of all optimizers that are due now. The SDF gets gradients only if it is learned now."""
        for group in self.sdf.param_groups:
            for parameter in group["params"]:
                parameter.requires_grad_(schedule.learns_shape)
        for optimizer, rate in ((self.sdf, schedule.sdf_rate), (self.heads, schedule.head_rate)):
            for group in optimizer.param_groups:
                group["lr"] = rate
        self.set_environment_rate(schedule)

    def set_environment_rate(self, schedule: Schedule) -> None:
        """Set the learning rate of F_e's optimizer that is due now."""
        environment_training.set_learning_rate(self.environment, self._environment.preset, schedule.environment_fraction)

    def state(self) -> dict:
        """The states of all optimizers, for a checkpoint."""
        return {name: getattr(self, name).state() for name in NAMES}

    def load(self, state: dict) -> None:
        """Go on from `state`. The fields must be loaded before."""
        for name in NAMES:
            self.restart(name)
        for name, values in state.items():
            getattr(self, name).load(values)
