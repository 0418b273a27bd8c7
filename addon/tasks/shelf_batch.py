"""The batches of shelf folders, as the sidebar shows them: those that this Blender has started, and all others.

A batch is followed by the files in its folder. So it is shown, too, if it was started by a terminal, by another computer
that shares the disk, or by an earlier session of Blender.
"""

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

from ...backend.engine.command import EngineError
from ...backend.engine.commands.batch_process import BatchError, BatchProcess
from ...backend.engine.results.batch_file import BatchFile, ask_to_stop, has_batch, is_batch_running, read_batch
from . import registry
from .registry import Task

KEPT_S = 1.0
"""So long what was read of a folder is kept at least."""
KEPT_TIMES = 30
"""It is kept so many times as long as it took to read, so that a large batch or a slow drive does not slow down Blender."""


class ShelfBatch(Task):
    """What is known of the batch in `folder`. It has `ended` where no batch is at work there.

    `file`: its batch.json; None where there is none. `problem`: why batch.json cannot be read. `process`: the engine, if
    this Blender has started it. `failed`: how that ended. `gallery_problem`: why its pages cannot be written.
    """

    one_per_folder = True

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.process: BatchProcess | None = None
        self.failed: BatchError | None = None
        self.file: BatchFile | None = None
        self.problem, self.stopping = "", False
        self.gallery_problem = ""
        self._kept_until = 0.0
        self._keeps_going = False

    def look(self, now: Callable[[], float] = time.monotonic) -> None:
        """Read the folder's files again, if that was long enough ago."""
        began = now()
        if began < self._kept_until:
            return
        self.file, self.problem = None, ""
        try:
            self.file = read_batch(self.folder) if has_batch(self.folder) else None
        except ValueError as error:
            self.problem = str(error)
        self.ended = self.process is None and not is_batch_running(self.folder)
        self.stopping = self.stopping and not self.ended
        end = now()
        self._kept_until = end + max(KEPT_S, KEPT_TIMES * (end - began))

    def begin(self, process: BatchProcess, keeps_going: bool) -> None:
        """An engine was just started in the folder."""
        self.process, self._keeps_going, self.failed, self.stopping = process, keeps_going, None, False
        self.ended = False
        self.forget()

    def poll(self) -> bool:
        if self.process is not None and self.process.poll():
            self.failed, self.process = self.process.failed, None
            self.forget()
        if self.process is not None and self._keeps_going and self.stopping and is_batch_running(self.folder):
            # When the engine has the lock, it removes what asks it to stop: that may be a leftover of an earlier batch.
            with suppress(OSError):  # the next call tries again
                ask_to_stop(self.folder)
        self.look()
        return self.ended

    def stop(self) -> None:
        """Ask the batch to write its checkpoints and to end.

        A batch that has not begun yet is asked by `poll`, as soon as it has. Raises OSError where the folder cannot be
        written.
        """
        if self.process is not None and not self._keeps_going:
            self.process.stop()
        elif self.process is None or is_batch_running(self.folder):
            ask_to_stop(self.folder)
        self.stopping = True

    def forget(self) -> None:
        """Read the files at the next look."""
        self._kept_until = 0.0

    def displayed_state(self) -> object:
        progress = None if self.process is None else self.process.progress
        return self.file, self.problem, self.stopping, progress

    def close(self) -> None:
        """A batch that was not started to keep going writes its checkpoints and ends."""
        if self.process is not None:
            self.process.close()

    def outlives_file(self) -> bool:
        """The batch lies in its folder, and another file may name the same folder."""
        return True


def batch_in(folder: Path) -> ShelfBatch:
    """What is known of the batch in the folder. A batch that is at work is followed from now on."""
    batch = registry.find(ShelfBatch, folder) or registry.keep(ShelfBatch(folder))
    batch.look()
    if not batch.ended:
        registry.start(batch)
    return batch


def start_batch(
    python: str, captures: Sequence[Path], folder: Path, *, keep_going: bool, wait: bool, **options: object
) -> ShelfBatch:
    """Start the engine with a batch in the folder, and follow it.

    With `wait` this function returns after the batch's end; else it returns at once. `options`: those of `batch_arguments`.
    NoEngineError where the engine cannot be started.
    """
    process = BatchProcess(python, captures, folder, keep_going=keep_going, **options)
    batch = batch_in(folder)
    batch.begin(process, keep_going)
    return registry.start(batch, wait=wait)


def keep_failed_start(folder: Path, error: EngineError) -> BatchError:
    """Keep, for the panel, why a batch in this folder could not be started. Returns the error."""
    batch = batch_in(folder)
    batch.failed = BatchError.of(error)
    return batch.failed
