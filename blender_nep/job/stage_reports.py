"""Typed views of the reports of the long stages. The stages themselves give plain dicts, which are saved on the disk."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

from blender_nep.messages import Message, Part


@dataclass(frozen=True)
class StageReportView:
    """The report of one stage."""

    facts: dict[str, Any]
    """The entry of the stage under `stages` in report.json"""
    skipped: dict[str, Message]
    """{part that was left out: why}"""
    seconds_saved: dict[str, float]
    """{part that was left out: seconds saved}"""
    acted: tuple[str, ...]
    """Names of the refinements and of the evidence that have changed or decided something"""

    @classmethod
    def of(cls, report: dict[str, Any]) -> Self:
        """The typed report for the dict that a stage gives."""
        entries = report.get("refinements", {}) | report.get("evidence", {})
        skipped = report.get("skipped", {}) | {name: e["skipped"] for name, e in entries.items() if "skipped" in e}
        return cls(
            facts={k: v for k, v in report.items() if k not in ("skipped", "seconds_saved")},
            skipped={part: Message.from_state(why) for part, why in skipped.items()},
            seconds_saved=report.get("seconds_saved", {}),
            acted=(
                *((Part.CAMERA_RESPONSE,) if "response" in report else ()),
                *((Part.OBJECT_GAINS,) if "object_gains" in report else ()),
                *((Part.PHOTOGRAPHER,) if "photographer" in report else ()),
                *(name for name, entry in entries.items() if "acted" in entry),
            ),
        )


@dataclass(frozen=True)
class FieldsReportView(StageReportView):
    """The report of fields learning."""

    @property
    def steps_saved(self) -> float:
        """Steps that the preset allows but learning did not need, divided by the steps that were taken.

        0 with a given mesh.
        """
        return self.facts["of_steps"] / self.facts["steps"] - 1 if "of_steps" in self.facts else 0.0

    @property
    def steps_not_finite(self) -> int:
        """Number of steps that were left out because their loss or gradient was not finite."""
        return self.facts.get("steps_not_finite", 0)


@dataclass(frozen=True)
class SurfaceReportView(StageReportView):
    """The report of the surface stage."""

    @property
    def cut_by_sphere(self) -> float:
        """Share of the surface that is a cap where the object reaches out of its sphere, 0..1. 0 with a given mesh."""
        return self.facts.get("cut_by_sphere", 0.0)


@dataclass(frozen=True)
class MaterialsReportView(StageReportView):
    """The report of material learning."""

    @property
    def light_seconds(self) -> float:
        """Seconds that gathering light took; about 0 where the light came from a checkpoint."""
        return self.facts.get("seconds", {}).get("light", 0.0)

    @property
    def metal_or_not_margin(self) -> float | None:
        """How much worse, as a share, the photos are explained with a material's class (metal or dielectric) swapped.

        It is the smallest share of all materials. None where the classes were not compared, for example because the user
        has chosen the class.
        """
        return self.facts.get("metal_or_not_margin")
