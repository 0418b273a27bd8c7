"""Keeps the seconds, losses and resumed stages of a job, and sends its progress."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from blender_nep.job.reporting.events import Events
from blender_nep.job.reporting.timeline import Timeline
from blender_nep.job.stage_names import StageName


class Tracker:
    """Follows a job from stage to stage."""

    def __init__(self, expected: Mapping[StageName, float], events: Events) -> None:
        """`expected` is a first guess of the seconds of every stage."""
        self._timeline, self._events = Timeline({str(stage): seconds for stage, seconds in expected.items()}), events
        self.seconds: dict[StageName, float] = {}
        self.losses: dict[StageName, float] = {}
        """The last loss of each stage that has learned."""
        self.resumed: list[StageName] = []
        """Stages whose results were taken from the disk."""

    def enter(self, stage: StageName) -> None:
        """Note that a stage begins."""
        self._timeline.enter(stage)

    def begin_at(self, fraction: float) -> None:
        """Note that the current stage goes on from a checkpoint: `fraction` of it (0..1) was done before."""
        self._timeline.begin_at(fraction)

    def report(self, stage: StageName, step: int, steps: int, loss: float | None = None, **extra: Any) -> None:
        """Send how far the stage is. `extra["preview"]` is the path of a picture to show; the rest goes into the event."""
        if loss is not None:
            self.losses[stage] = float(loss)
        fraction, eta = self._timeline.at(step / max(steps, 1))
        preview = extra.pop("preview", None)
        self._events.progress(stage, step, steps, fraction, eta, None if loss is None else float(loss), **extra)
        if preview is not None:
            self._events.preview(Path(preview))

    def leave(self, stage: StageName, seconds: float) -> None:
        """Note that the stage has ended, and how many seconds it took."""
        self.seconds[stage] = seconds
        self._timeline.leave()

    def take_over(self, stage: StageName, seconds: float) -> None:
        """Note that the stage's result was on the disk, and how many seconds an earlier run took for it."""
        self.seconds[stage] = seconds
        self.resumed.append(stage)
        self._timeline.leave(skipped=True)
