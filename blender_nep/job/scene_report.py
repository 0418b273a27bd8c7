"""Collects what a job says about its scene and what it leaves out, and tells it to the report, the terminal and the UI."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from blender_nep.job.reporting.events import Events
from blender_nep.messages import Message, Part
from blender_nep.scene.analysis import Analysis, Plan

if TYPE_CHECKING:
    from blender_nep.scene.scene import Scene


class SceneReport:
    """Facts, sentences and left-out parts of the scene. Stages add to them, and every addition is told at once."""

    def __init__(self, events: Events) -> None:
        self._events = events
        self.facts: dict[str, dict] = {}
        self.sentences: list[Message] = []
        self.skipped: dict[str, Message] = {}
        """{part that is left out: why}"""
        self.seconds_saved: dict[str, float] = {}
        """{part that is left out: seconds saved}, only where this run measured the time of a similar part"""

    def add(self, name: str, found: Analysis, plan: Plan) -> None:
        """Add the facts of the photos or of the surface under `name`, and what `plan` leaves out."""
        self.facts[name] = found.facts()
        self.sentences += found.sentences()
        self.skipped |= plan.skipped
        self._emit(found.sentences() + _lines(plan.skipped, {}))

    def left_out(self, scene: Scene, *, masks_ignored: bool, mesh_given: bool) -> None:
        """Add the parts that have nothing to work on in this scene, whatever the preset says."""
        if not scene.photos.masks:
            why = Message("reason.masks_ignored") if masks_ignored else Message("reason.no_masks")
            self.skipped[Part.MASK_TERM] = why
        if scene.photos.backdrop and len(scene.rays.outside) == 0:
            self.skipped[Part.PIXELS_OUTSIDE] = Message("reason.sphere_fills_photos")
        if mesh_given:
            self.skipped[Part.SURFACE_EXTRACTION] = Message("reason.mesh_given")

    def act(self, parts: Sequence[str]) -> None:
        """Add the parts that have changed or decided something in this scene, although not every scene needs them."""
        if parts:
            line = Message("scene.acted", {"parts": list(parts)})
            self.sentences.append(line)
            self._emit([line])

    def explain(self, lines: list[Message]) -> None:
        """Add how well the photos are explained."""
        if lines:
            self.sentences += lines
            self._emit(lines)

    def skip(self, skipped: Mapping[str, Message], seconds: Mapping[str, float]) -> None:
        """Add what a stage has left out. A part that was left out before keeps its first reason."""
        new = {what: why for what, why in skipped.items() if what not in self.skipped}
        self.skipped |= new
        self.seconds_saved |= {what: round(value, 2) for what, value in seconds.items()}
        if new or seconds:
            self._emit(_lines(new, seconds))

    def stopped_early(self, steps_saved: float, seconds: float) -> None:
        """Add that fields learning stopped early. It took `seconds`; all steps would take `steps_saved` times that more."""
        if steps_saved > 0:
            part = Part.FURTHER_STEPS
            self.skip({part: Message("reason.plateaued")}, {part: seconds * steps_saved})

    def report(self) -> dict:
        """The keys `scene`, `skipped` and `skipped_seconds` of report.json."""
        return {
            "scene": {**self.facts, "sentences": [line.to_dict() for line in self.sentences]},
            "skipped": {part: why.to_dict() for part, why in self.skipped.items()},
            "skipped_seconds": self.seconds_saved,
        }

    def _emit(self, new: list[Message]) -> None:
        for line in new:
            self._events.say(f"  {line}")
        self._events.scene(self.sentences + _lines(self.skipped, self.seconds_saved))


def _lines(skipped: Mapping[str, Message], seconds: Mapping[str, float]) -> list[Message]:
    """One sentence for each reason, with all parts that are left out for it."""
    reasons: list[tuple[Message, list[str]]] = []
    for part, why in skipped.items():
        parts = next((parts for reason, parts in reasons if reason == why), None)
        if parts is None:
            reasons.append((why, [str(part)]))
        else:
            parts.append(str(part))
    lines = []
    for why, parts in reasons:
        saved = sum(seconds.get(part, 0.0) for part in parts)
        if saved >= 0.5:
            lines.append(Message("scene.left_out_saving", {"parts": parts, "reason": why, "seconds": saved}))
        else:
            lines.append(Message("scene.left_out", {"parts": parts, "reason": why}))
    return lines
