"""Gives the SDF its finest levels, when the coarse ones have found the shape."""

from __future__ import annotations

from blender_nep.fields.refinements.refinement import Change
from blender_nep.fields.stage import StageOne
from blender_nep.messages import Message, Part


class FinestLevels:
    """Adds the last levels of the SDF's grid. They are zero at first, so that the SDF does not change."""

    name = Part.LEVELS

    def __init__(self, at: float, levels: int) -> None:
        self.at, self._levels = (at,), levels

    def skipped(self, stage: StageOne) -> Message | None:
        return None if stage.object_field.level_count < self._levels else Message("reason.levels_there")

    def apply(self, stage: StageOne) -> Change:
        stage.object_field.add_levels(self._levels)
        return Change(True, {"cells": stage.cells}, ("sdf",))
