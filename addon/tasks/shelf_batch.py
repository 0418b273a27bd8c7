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
from ..folders import folder_key
from . import clock

KEPT_S = 1.0
"""So long what was read of a folder is kept at least."""
KEPT_TIMES = 30
"""It is kept so many times as long as it took to read, so that a large batch or a slow drive does not slow down Blender."""


class ShelfBatch:
    """What is known of the batch in `folder`.

    `file`: its batch.json; None where there is none. `problem`: why batch.json cannot be read. `running`: whether a batch is
    at work there. `process`: the engine, if this Blender has started it. `failed`: how that ended. `gallery_problem`: why
    its pages cannot be written.
    """

    def __init__(self, folder: Path) -> None:
        self.folder, self.process, self.failed = folder, None, None
        self.file: BatchFile | None = None
        self.problem, self.running, self.stopping = "", False, False
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
        self.running = self.process is not None or is_batch_running(self.folder)
        self.stopping = self.stopping and self.running
        end = now()
        self._kept_until = end + max(KEPT_S, KEPT_TIMES * (end - began))

    def start(self, process: BatchProcess, keeps_going: bool) -> None:
        """Follow an engine that was just started in the folder."""
        self.process, self._keeps_going, self.failed, self.stopping = process, keeps_going, None, False
        self.running = True  # from now on, so that the timer follows it
        self.forget()

    def poll(self) -> bool:
        """Read what is new. Returns whether the batch goes on."""
        if self.process is not None and self.process.poll():
            self.failed, self.process = self.process.failed, None
            self.forget()
        if self.process is not None and self._keeps_going and self.stopping and is_batch_running(self.folder):
            # When the engine has the lock, it removes what asks it to stop: that may be a leftover of an earlier batch.
            with suppress(OSError):  # the next call tries again
                ask_to_stop(self.folder)
        self.look()
        return self.running

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
        """What the sidebar shows of it."""
        progress = None if self.process is None else self.process.progress
        return self.file, self.problem, self.running, self.stopping, progress


_batches: dict[str, ShelfBatch] = {}  # by the key of the folder


def batch_in(folder: Path) -> ShelfBatch:
    """What is known of the batch in the folder. A batch that is at work is followed from now on."""
    batch = _batches.setdefault(folder_key(folder), ShelfBatch(folder))
    batch.look()
    if batch.running:
        clock.call_until_false(_advance)
    return batch


def any_at_work() -> bool:
    """Whether a batch that this Blender knows is at work."""
    return any(batch.running for batch in _batches.values())


def start_batch(
    python: str, captures: Sequence[Path], folder: Path, *, keep_going: bool, wait: bool, **options: object
) -> ShelfBatch:
    """Start the engine with a batch in the folder, and follow it.

    With `wait` this function returns after the batch's end; else it returns at once. `options`: those of `batch_arguments`.
    NoEngineError where the engine cannot be started.
    """
    process = BatchProcess(python, captures, folder, keep_going=keep_going, **options)
    batch = batch_in(folder)
    batch.start(process, keep_going)
    clock.call_until_false(_advance)
    while wait and batch.poll():
        time.sleep(clock.PERIOD_S)
    return batch


def keep_failed_start(folder: Path, error: EngineError) -> BatchError:
    """Keep, for the panel, why a batch in this folder could not be started. Returns the error."""
    batch = batch_in(folder)
    batch.failed = BatchError.of(error)
    return batch.failed


def _advance() -> bool:
    """Follow all batches that are at work, once every clock period. Returns whether there is one."""
    going = False
    for batch in _batches.values():
        if batch.running:
            before = batch.displayed_state()
            going |= batch.poll()
            if batch.displayed_state() != before:
                clock.redraw_sidebars_soon()
    return going


def close_all() -> None:
    """Blender or the add-on ends: batches that were not started to keep going write their checkpoints and end."""
    for batch in _batches.values():
        if batch.process is not None:
            batch.process.close()
    _batches.clear()
