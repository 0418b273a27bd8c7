"""Runs the engine that makes assets of many captures (`blender_nep batch`). No bpy in this file."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..command import EngineError, batch_arguments
from ..exit_codes import STOPPED
from ..words import BATCH_HINTS
from .short_command import CommandError, ShortCommand

STOP_GRACE_S = 180.0
"""Time for all jobs to write their checkpoints. The engine itself kills a job that does not stop within two minutes."""


class BatchError(CommandError):
    """The batch was stopped or has failed, or some of its objects have failed."""

    hints = BATCH_HINTS


class BatchProcess(ShortCommand):
    """An engine that makes assets of many captures.

    It can be stopped. Without `keep_going` it stops when this program ends. The same command goes on with what is left.
    """

    error_type = BatchError
    retry = "Press Reconstruct Shelf again: it goes on with what is left."
    outdated = "The installed engine is older than this add-on, and knows no batches."

    def __init__(self, python: str, captures: Sequence[Path | str], out: Path, *, keep_going: bool = False, **options: Any):
        """Start the engine; `options` are those of `batch_arguments`. Raises NoEngineError where it cannot be started."""
        self.stopping = False
        arguments = batch_arguments(captures, out, keep_going=keep_going, **options)
        super().__init__(python, arguments, keep_going=keep_going)

    def stop(self) -> None:
        """Ask the engine to write the checkpoints of its jobs and to end."""
        self.stopping = True
        self._engine.request_stop(STOP_GRACE_S)

    def _outcome(self) -> EngineError | None:
        error = super()._outcome()
        if error is not None and error.code == STOPPED and not error.name:  # it ended before it could say so
            return EngineError(STOPPED, "Stopped.", name="stopped.batch")
        return error
