"""The progress of material learning: its steps, its checkpoints, and the seconds of its phases."""

from __future__ import annotations

import time
from collections.abc import Callable

_STEPS = 100


class TrainingProgress:
    """Reports the steps of material learning, saves the checkpoints that are due, and measures the time of each phase."""

    def __init__(self, callback: Callable, checkpoint, seconds: dict[str, float], start: float) -> None:
        """callback(step, steps, loss) may raise. The times of the phases are written to the dict `seconds`.

        `start` is the start of the first phase, as `time.monotonic` gives it.
        """
        self.callback, self.checkpoint, self.seconds = callback, checkpoint, seconds
        self.done, self.start = 0, start
        self.loss: float | None = None
        """Nothing has been learned yet"""
        self.state: dict = {}
        """The content of the checkpoint. It is empty until the light is gathered: a resumed job repeats all other work."""
        self._saved: dict | None = None

    def step(self, step: int) -> None:
        """Report that `step` of 100 steps is reached, and save the checkpoint if it is due."""
        self.done = step
        if self.checkpoint.due() and self._saved is self.state:
            self.checkpoint.keep()
        elif self.checkpoint.due():
            self.checkpoint.save(self.state)
            self._saved = self.state
        self.callback(step, _STEPS, self.loss)

    def phase_ended(self, name: str) -> None:
        """Note that the phase `name` has ended. It began when the phase before it ended."""
        now = time.monotonic()
        self.seconds[name] = round(now - self.start, 2)
        self.start = now
