"""The result of fields learning, and its report."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field

import torch

from blender_nep.fields.environment.field import EnvironmentField
from blender_nep.fields.object.field import ObjectField
from blender_nep.presets import Preset
from blender_nep.support.plane import Support


@dataclass(frozen=True)
class FieldsReport:
    """The report on the learning of both fields."""

    steps: int
    """Number of steps that were taken, with those of F_e alone and of the colors"""
    of_steps: int
    """Number of steps that would have been taken if the validation error had not stopped falling"""
    held_out_error: list[float]
    """Validation errors, the oldest first: mean tone-mapped error of held-out pixels of the object"""
    loss: float
    """Photometric loss of the last step"""
    explanation_ratio: float
    """Error of F_e alone divided by the error of the object, on the object's pixels (`explanation.explanation_ratio`)"""
    steps_not_finite: int
    """Number of steps that were left out because their loss or gradient was not finite"""
    refinements: dict[str, dict] = field(default_factory=dict)
    """{name of a refinement: what it has done, or why it was skipped} (`refinements.driver`)"""

    def as_dict(self) -> dict:
        """The report as plain values, rounded, for report.json. A count of 0 steps that were left out is not in it."""
        found = asdict(self)
        found["held_out_error"] = [round(error, 4) for error in self.held_out_error]
        found["explanation_ratio"] = round(self.explanation_ratio, 3)
        if not self.steps_not_finite:
            del found["steps_not_finite"]
        return found


@dataclass
class Fields:
    """The result of fields learning."""

    object_field: ObjectField | None
    """None if a mesh was given, so that only F_e was learned"""
    environment: EnvironmentField
    report: dict
    """The report for report.json"""
    support: Support | None = None
    """The plane on which the object stands, if the photos show one"""

    def state(self) -> dict:
        """The result as a dict of tensors and numbers, as it is saved on the disk."""
        objects = None
        if self.object_field is not None:
            objects = {"structure": self.object_field.structure(), "weights": self.object_field.state_dict()}
        support = None if self.support is None else self.support.state()
        return {"object": objects, "environment": self.environment.state_dict(), "report": self.report, "support": support}

    @classmethod
    def from_state(cls, state: dict, preset: Preset, device: torch.device) -> Fields:
        """The inverse of `state`."""
        environment = EnvironmentField(preset.environment).to(device)
        environment.load_state_dict(state["environment"])
        support = None if state["support"] is None else Support.from_state(state["support"])
        objects = None
        if state["object"] is not None:
            objects = new_object_field(preset, device)
            objects.grow(state["object"]["structure"])
            objects.load_state_dict(state["object"]["weights"])
            objects.stand_on(support)
        return cls(objects, environment, state["report"], support)


def new_object_field(preset: Preset, device: torch.device) -> ObjectField:
    """The object field before learning: a sphere, with only the coarsest level."""
    p = preset.fields
    return ObjectField(p.coarsest_cells, p.initial_radius, p.head_width, p.decomposition).to(device)
