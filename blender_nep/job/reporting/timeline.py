"""Estimates how far a job is, and how long it still takes."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping


def time_text(seconds: float) -> str:
    """The time as text: 75 gives '1:15', 3675 gives '1:01:15', a value that is not finite gives '?'."""
    if not math.isfinite(seconds):
        return "?"
    whole = max(0, round(seconds))
    hours, minutes = divmod(whole // 60, 60)
    return f"{hours}:{minutes:02d}:{whole % 60:02d}" if hours else f"{minutes}:{whole % 60:02d}"


class Timeline:
    """Estimates how far the whole job is, and how long it still takes.

    Each stage brings a first guess of its seconds. Once a stage has advanced by 2 %, or for 15 seconds, the time left in it
    follows its own pace. The guesses of later stages are scaled by how wrong the guesses were so far.
    """

    def __init__(self, expected: Mapping[str, float], clock: Callable[[], float] = time.monotonic) -> None:
        self.expected = {stage: max(seconds, 0.1) for stage, seconds in expected.items()}
        self._clock = clock
        self._spent = 0.0
        self._guessed = 0.0
        self._stage = ""
        self._stage_start = 0.0
        self._first = 0.0
        self._done: set[str] = set()

    def enter(self, stage: str) -> None:
        """Note that a stage begins."""
        self._stage, self._stage_start, self._first = stage, self._clock(), 0.0

    def begin_at(self, fraction: float) -> None:
        """Note that `fraction` of the current stage (0..1) was done in an earlier run and takes no time now."""
        self._first = fraction

    def leave(self, *, skipped: bool = False) -> None:
        """Note that the current stage has ended. `skipped`: it took no time, because its result was on the disk."""
        self._done.add(self._stage)
        if not skipped:
            self._spent += self._clock() - self._stage_start
            self._guessed += self.expected[self._stage] * (1 - self._first)

    def at(self, fraction: float) -> tuple[float, float]:
        """(fraction of the whole job, seconds left) when the current stage is `fraction` done (0..1)."""
        elapsed, guess = self._clock() - self._stage_start, self.expected[self._stage]
        advanced = fraction - self._first
        shows = advanced > 0.02 or (advanced > 0 and elapsed > 15)
        if shows:
            pace = (self._spent + elapsed) / (self._guessed + guess * advanced)
        else:
            pace = self._spent / self._guessed if self._guessed > 1 else 1.0
        stage_left = elapsed / advanced * (1 - fraction) if shows else guess * pace * (1 - fraction)
        later = sum(s for r, s in self.expected.items() if r not in self._done and r != self._stage)
        done = sum(s for r, s in self.expected.items() if r in self._done) + guess * fraction
        return min(done / sum(self.expected.values()), 1.0), stage_left + later * min(max(pace, 0.1), 20.0)
