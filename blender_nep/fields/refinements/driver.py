"""Applies the refinements of stage 1 when they are due, and keeps what each of them has done."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field

from blender_nep.fields.refinements.refinement import Refinement
from blender_nep.fields.stage import StageOne
from blender_nep.messages import Message, Part

_DIGITS = 4
"""What a refinement has found is reported with so many significant digits; counts are whole."""


@dataclass
class Record:
    """What one refinement has done so far."""

    passed: int = 0
    """How many of its fractions are behind"""
    acted: list[float] = field(default_factory=list)
    """Fractions of the learning at which it has changed something"""
    found: dict[str, float] = field(default_factory=dict)
    """What it has found last"""
    skipped: dict | None = None
    """The state of the message that says why it was skipped last; None if it was not"""

    def report(self) -> dict:
        """The entry in report.json: `acted` or `skipped`, and what was found."""
        found = {n: value if isinstance(value, int) else float(f"{value:.{_DIGITS}g}") for n, value in self.found.items()}
        if self.acted:
            return {"acted": [round(fraction, 3) for fraction in self.acted], **found}
        why = Message("reason.found_nothing") if self.skipped is None else Message.from_state(self.skipped)
        return {"skipped": why.to_dict(), **found}


class RefinementDriver:
    """Applies refinements in their order. The names in `without` are switched off."""

    def __init__(self, refinements: Sequence[Refinement], without: Sequence[str] = ()) -> None:
        self._refinements, self._without = refinements, frozenset(without)
        self._records = {refinement.name: Record() for refinement in refinements}
        for refinement in refinements:
            if refinement.name in without or not any(at <= 1 for at in refinement.at):
                self._records[refinement.name].skipped = Message("reason.preset").state()

    def apply_due(self, stage: StageOne) -> None:
        """Apply the refinements that are due now."""
        for refinement, record in self._due(stage.schedule.fraction):
            why = refinement.skipped(stage)
            if why is None:
                change = refinement.apply(stage)
                for name in change.renewed:
                    stage.optimizers.restart(name)
                if change.acted:
                    record.acted.append(stage.schedule.fraction)
                record.found = dict(change.found)
            record.skipped = None if why is None else why.state()

    def _due(self, fraction: float) -> Iterator[tuple[Refinement, Record]]:
        for refinement in self._refinements:
            record = self._records[refinement.name]
            reached = sum(fraction >= at for at in refinement.at)
            if refinement.name not in self._without and reached > record.passed:
                record.passed = reached
                yield refinement, record

    def report(self) -> dict[str, dict]:
        """{name of the refinement: what it has done, or why it was skipped}, as plain values for report.json."""
        return {str(name): record.report() for name, record in self._records.items()}

    def state(self) -> dict[str, dict]:
        """All records as plain values, for a checkpoint."""
        return {str(name): asdict(record) for name, record in self._records.items()}

    def load(self, state: dict[str, dict]) -> None:
        """Go on from `state`."""
        self._records = {Part(name): Record(**record) for name, record in state.items()}
