"""What the long stages say of their work, with types: the stages themselves give plain dicts, which go to the disk."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

from blender_nep.messages import Message


@dataclass(frozen=True)
class StageReport:
    """What every stage may say."""

    facts: dict[str, Any]
    """What stands in report.json, below `stages`"""
    skipped: dict[str, Message]
    """{what was left out: why}"""
    seconds_saved: dict[str, float]
    """{what was left out: seconds}"""

    @classmethod
    def of(cls, report: dict[str, Any]) -> Self:
        """From the dict of a stage."""
        return cls(
            facts={k: v for k, v in report.items() if k not in ("skipped", "seconds_saved")},
            skipped={part: Message.from_state(why) for part, why in report.get("skipped", {}).items()},
            seconds_saved=report.get("seconds_saved", {}),
        )


@dataclass(frozen=True)
class FieldsReport(StageReport):
    """Stage 1."""

    @property
    def steps_saved(self) -> float:
        """Share of steps, of those that were taken, that the preset allows and learning did not need; 0 with a given
        mesh."""
        return self.facts["of_steps"] / self.facts["steps"] - 1 if "of_steps" in self.facts else 0.0

    @property
    def steps_not_finite(self) -> int:
        """Steps that were left out."""
        return self.facts.get("steps_not_finite", 0)


@dataclass(frozen=True)
class MaterialsReport(StageReport):
    """Stage 2."""

    @property
    def light_seconds(self) -> float:
        """Seconds of gathering light; about 0 where the light came from a checkpoint."""
        return self.facts.get("seconds", {}).get("light", 0.0)

    @property
    def metal_or_not_margin(self) -> float | None:
        """Share of the error by which the material found is better than the other way round; None where it is known."""
        return self.facts.get("metal_or_not_margin")
