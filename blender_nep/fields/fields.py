"""The result of fields learning, and its report."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import torch

from blender_nep.fields.environment.field import EnvironmentField
from blender_nep.fields.object.field import ObjectField
from blender_nep.fields.refinements.relief import Relief
from blender_nep.presets import Preset
from blender_nep.support.plane import Support


@dataclass(frozen=True)
class HullReport:
    """The visual hull from which the SDF started."""

    volume: float
    """Share of the object's sphere that the hull fills"""
    contrast: float
    """Mean silhouette value inside the hull divided by that outside"""


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
    hull: HullReport | None
    """None where the SDF started from a sphere"""
    fine_paint: float | None
    """How far photos from above and from below agree on fine colors (`fine_paint.fine_paint`). None where the SDF started
    from a sphere"""
    hidden_pixels: int = 0
    """Number of pixels whose masks do not show the object because something stands before it (`hidden_object`)"""
    relief: Relief | None = None
    """The relief that was found last, finer than the SDF's grid (`relief.find_relief`)"""

    def as_dict(self) -> dict:
        """The report as plain values, rounded, for report.json. None and counts of 0 are left out."""
        found = asdict(self)
        found["held_out_error"] = [round(error, 4) for error in self.held_out_error]
        found["explanation_ratio"] = round(self.explanation_ratio, 3)
        if not self.steps_not_finite:
            del found["steps_not_finite"]
        if not self.hidden_pixels:
            del found["hidden_pixels"]
        if self.relief is None:
            del found["relief"]
        else:
            found["relief"] = {"share": round(self.relief.share, 3), "tilt_deg": round(self.relief.tilt_deg, 2)}
        if self.hull is None:
            del found["hull"]
        else:
            found["hull"] = {"volume": round(self.hull.volume, 4), "contrast": round(self.hull.contrast, 2)}
        if self.fine_paint is None:
            del found["fine_paint"]
        else:
            found["fine_paint"] = round(self.fine_paint, 3)
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
        field = None
        if state["object"] is not None:
            field = new_object_field(preset, device)
            field.grow(state["object"]["structure"])
            field.load_state_dict(state["object"]["weights"])
            field.support = support
        return cls(field, environment, state["report"], support)


def new_object_field(preset: Preset, device: torch.device) -> ObjectField:
    """The object field before learning: a sphere, with only the coarsest level."""
    p = preset.fields
    return ObjectField(p.coarsest_cells, p.initial_radius, p.head_width, p.decomposition).to(device)
