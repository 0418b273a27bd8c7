"""What a refinement is: something that improves stage 1 between its steps, such as the start from a visual hull.

A refinement says at which fractions of the learning it is due, and why a scene does not need it. The driver (`driver`) does
the rest: it calls what is due, makes optimizers anew, saves the counts, and writes the report.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

from blender_nep.fields.field_optimizers import OptimizerName
from blender_nep.fields.stage import StageOne
from blender_nep.messages import Message, Part


@dataclass(frozen=True)
class Change:
    """What a refinement has done."""

    acted: bool
    """Whether it has changed the state of stage 1"""
    found: Mapping[str, float] = field(default_factory=dict)
    """What it has found, as a few numbers for the report"""
    renewed: tuple[OptimizerName, ...] = ()
    """The optimizers whose parameters are new, so that they must be made anew"""


class Refinement(Protocol):
    """Something that improves stage 1 between its steps."""

    @property
    def name(self) -> Part:
        """Its name in the preset's `without` and in the report."""
        ...

    @property
    def at(self) -> tuple[float, ...]:
        """Fractions of the learning of both fields, rising, at which it is due. Empty: never.

        If several are reached in one step, it is applied once.
        """
        ...

    def skipped(self, stage: StageOne) -> Message | None:
        """Why this scene does not need it; None if it does. It is asked each time that the refinement is due."""
        ...

    def apply(self, stage: StageOne) -> Change:
        """Improve the state of stage 1."""
        ...
