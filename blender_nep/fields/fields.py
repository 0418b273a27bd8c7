"""What stage 1 has learned, and how that went."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import torch

from blender_nep.fields.environment_field import EnvironmentField
from blender_nep.fields.object_field import ObjectField
from blender_nep.presets import Preset


@dataclass(frozen=True)
class HullReport:
    """The visual hull that the SDF started from."""

    volume: float
    """Share of the object's sphere"""
    contrast: float
    """Mean silhouette value inside over that outside"""


@dataclass(frozen=True)
class FieldsReport:
    """How the learning of both fields went."""

    steps: int
    """Steps taken, those of F_e alone included"""
    of_steps: int
    """Steps that there would have been without a plateau of the validation error"""
    held_out_error: list[float]
    """Validation errors, the oldest first: mean tone-mapped error of held-out pixels of the object"""
    loss: float
    """Photometric loss of the last step"""
    explanation_ratio: float
    """How much better the object explains its pixels than F_e alone"""
    steps_not_finite: int
    """Steps that were left out because their loss or gradient was not finite"""
    hull: HullReport | None
    """None where the SDF started from a sphere"""

    def as_dict(self) -> dict:
        """For report.json, rounded. `hull` and `steps_not_finite` are left out where there were none."""
        found = asdict(self)
        found["held_out_error"] = [round(error, 4) for error in self.held_out_error]
        found["explanation_ratio"] = round(self.explanation_ratio, 3)
        if not self.steps_not_finite:
            del found["steps_not_finite"]
        if self.hull is None:
            del found["hull"]
        else:
            found["hull"] = {"volume": round(self.hull.volume, 4), "contrast": round(self.hull.contrast, 2)}
        return found


@dataclass
class Fields:
    """What stage 1 has learned."""

    object_field: ObjectField | None
    """None where a mesh was given and F_e was learned alone."""
    environment: EnvironmentField
    report: dict
    """How it went, for report.json"""

    def state(self) -> dict:
        """As a dict of tensors and numbers, for the disk."""
        objects = None
        if self.object_field is not None:
            objects = {"levels": self.object_field.level_count, "weights": self.object_field.state_dict()}
        return {"object": objects, "environment": self.environment.state_dict(), "report": self.report}

    @classmethod
    def from_state(cls, state: dict, preset: Preset, device: torch.device) -> Fields:
        """The inverse of `state`."""
        environment = EnvironmentField(preset.environment).to(device)
        environment.load_state_dict(state["environment"])
        field = None
        if state["object"] is not None:
            field = new_object_field(preset, device)
            for _ in range(state["object"]["levels"] - 1):
                field.add_level()
            field.load_state_dict(state["object"]["weights"])
        return cls(field, environment, state["report"])


def new_object_field(preset: Preset, device: torch.device) -> ObjectField:
    """F_o at the start: a sphere, its coarsest level alone."""
    p = preset.fields
    return ObjectField(p.coarsest_cells, p.initial_radius, p.head_width, p.decomposition).to(device)
