"""What a job has done so far: seconds, losses and resumed stages; and how it tells of its progress."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from blender_nep.job.events import Events
from blender_nep.job.stage_names import StageName
from blender_nep.job.timeline import Timeline


class Tracker:
    """Follows a job from stage to stage."""

    def __init__(self, expected: Mapping[StageName, float], events: Events) -> None:
        """expected: a first guess of the seconds of every stage."""
        self._timeline, self._events = Timeline({str(stage): seconds for stage, seconds in expected.items()}), events
        self.seconds: dict[StageName, float] = {}
        self.losses: dict[StageName, float] = {}
        """The last loss of each stage that has learned."""
        self.resumed: list[StageName] = []
        """Stages whose results were taken from the disk."""

    def enter(self, stage: StageName) -> None:
        """A stage begins."""
        self._timeline.enter(stage)

    def begin_at(self, fraction: float) -> None:
        """The stage goes on from a checkpoint: `fraction` of it was done before."""
        self._timeline.begin_at(fraction)

    def tell(self, stage: StageName, step: int, steps: int, loss: float | None = None, **extra: Any) -> None:
        """How far the stage is. extra: `preview` is the path of a picture that can be looked at; the rest is sent along."""
        if loss is not None:
            self.losses[stage] = float(loss)
        fraction, eta = self._timeline.at(step / max(steps, 1))
        preview = extra.pop("preview", None)
        self._events.progress(stage, step, steps, fraction, eta, None if loss is None else float(loss), **extra)
        if preview is not None:
            self._events.preview(Path(preview))

    def leave(self, stage: StageName, seconds: float) -> None:
        """The stage has ended after so many seconds."""
        self.seconds[stage] = seconds
        self._timeline.leave()

    def take_over(self, stage: StageName, seconds: float) -> None:
        """The stage's result was on the disk; an earlier run took so many seconds for it."""
        self.seconds[stage] = seconds
        self.resumed.append(stage)
        self._timeline.leave(skipped=True)
