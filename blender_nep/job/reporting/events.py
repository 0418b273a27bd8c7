"""Sends what a job says: JSON lines for programs to standard output, a progress bar or plain lines for people to stderr."""

from __future__ import annotations

import contextlib
import json
import math
import os
import sys
import time
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from tqdm import tqdm

from blender_nep.errors import NepError
from blender_nep.files import jsonable, open_in_place
from blender_nep.job.reporting.timeline import time_text
from blender_nep.messages import Message
from blender_nep.safety.printed_text import one_line

if TYPE_CHECKING:
    from blender_nep.job.folders.job_folder import Journal


def open_protocol() -> TextIO:
    """Return the real standard output, which carries only events from now on. All other prints go to stderr.

    The redirection works on file descriptors, so that prints of C and C++ libraries cannot break the protocol either.
    """
    sys.stdout.flush()
    stream = os.fdopen(os.dup(1), "w", encoding="utf-8", buffering=1)
    os.dup2(2, 1)
    sys.stdout = sys.stderr
    return stream


class Events:
    """Sends the events of one job to programs (`protocol`), people (`human`) and the log (`log`)."""

    def __init__(
        self,
        protocol: TextIO | Journal | None = None,
        human: TextIO | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._protocol, self._human, self._clock = protocol, human, clock
        self._log: TextIO | None = None
        self._bar: tqdm | None = None
        self._last_event = self._last_line = -math.inf
        self._last_step: tuple[str, int] | None = None
        self._pending: list[str] = []
        self.warnings: list[Message] = []

    def open_log(self, path: Path) -> None:
        """Open the log file and write what was said before. From now on everything is appended to it. Raises OutputError."""
        descriptor = open_in_place(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        self._log = open(descriptor, "a", encoding="utf-8", errors="backslashreplace")  # names of files may be no UTF-8
        for line in self._pending:
            self._log.write(line)
        self._pending.clear()
        self._log.flush()

    def move_to(self, folder: Path, journal: Journal) -> None:
        """Tell programs that events go to the job folder `folder` from now on, and send them to `journal`."""
        self.emit("job", folder=str(folder.resolve()))
        self._protocol = journal

    @property
    def has_log(self) -> bool:
        """Whether a log file is open."""
        return self._log is not None

    def log(self, *lines: str) -> None:
        """Write lines to the log only. Before `open_log`, they are kept for the log.

        The first line has the time, and the others are indented. Control characters are escaped, line breaks among them: no
        name of a file makes a line of its own.
        """
        first, *more = map(one_line, lines)
        stamped = (
            f"{time.strftime('%Y-%m-%d %H:%M:%S')} {first}",
            *(text if text.startswith(" ") else f"    {text}" for text in more),
        )
        line = "".join(f"{text}\n" for text in stamped)
        if self._log is None:
            self._pending.append(line)
            return
        try:
            self._log.write(line)
            self._log.flush()
        except OSError:  # the disk is full: the log ends, but the error itself must still reach the user
            self._log = None

    def log_traceback(self, error: BaseException) -> None:
        """Write the traceback of an error to the log only."""
        self.log(*"".join(traceback.format_exception(error)).rstrip("\n").split("\n"))

    def say(self, *lines: str) -> None:
        """Write lines for people, and to the log. Control characters are escaped, line breaks among them."""
        self.log(*lines)
        if self._human is None:
            return
        if self._bar is not None:
            self._bar.clear()
        self._print(*lines)

    def _print(self, *lines: str) -> None:
        with contextlib.suppress(OSError):  # stderr may be a file on a full disk
            print(*map(one_line, lines), sep="\n", file=self._human, flush=True)

    def emit(self, event: str, **content: Any) -> None:
        """Send one JSON line to programs. If the pipe is closed, or the disk of a file is full, nothing more is sent."""
        if self._protocol is None:
            return
        try:
            self._protocol.write(json.dumps({"event": event, **jsonable(content)}) + "\n")
            self._protocol.flush()
        except (OSError, ValueError):
            self._protocol = None

    def progress(
        self,
        stage: str,
        step: int,
        steps: int,
        fraction: float,
        eta: float,
        loss: float | None,
        note: Message | None = None,
        **extra: Any,
    ) -> None:
        """Send how far the job is: at most four events a second, but always the first and the last step of a stage.

        `fraction` is that of the whole job in 0..1, `eta` the seconds left. If there is a `note`, people see the note
        instead of the step.
        """
        now, edge = self._clock(), step in (0, steps) or self._last_step is None or self._last_step[0] != stage
        if (edge and self._last_step != (stage, step)) or now - self._last_event >= 0.25:
            self._last_event, self._last_step = now, (stage, step)
            self.emit(
                "progress",
                stage=stage,
                step=step,
                steps=steps,
                fraction=round(fraction, 4),
                eta_s=round(eta, 1),
                loss=loss,
                **({} if note is None else {"note": note.to_dict()}),
                **extra,
            )
            self._show(stage, f"{step}/{steps}" if note is None else str(note), fraction, eta, loss)

    def _show(self, stage: str, place: str, fraction: float, eta: float, loss: float | None) -> None:
        figure = "" if loss is None else f", loss {loss:.4f}"
        if self._human is not None and self._human.isatty():
            if self._bar is None:
                form = "{desc}: {percentage:3.0f}%|{bar}| {unit}"
                self._bar = tqdm(total=1.0, file=self._human, bar_format=form, dynamic_ncols=True)
            self._bar.n = fraction
            self._bar.unit = one_line(f"{place}{figure}, {time_text(eta)} left")
            self._bar.set_description_str(stage.replace("_", " "))
        if self._clock() - self._last_line >= 10:
            self._last_line = self._clock()
            text = f"{fraction:4.0%}  {stage.replace('_', ' ')} {place}{figure}, {time_text(eta)} left"
            self.log(text)
            if self._human is not None and self._bar is None:
                self._print(text)

    def preview(self, path: Path) -> None:
        """Send the path of a picture or mesh that is on the disk and can be shown."""
        self.emit("preview", path=str(path))

    def warning(self, message: Message) -> None:
        """Send a warning to programs and people. The same warning is sent only once."""
        if message not in self.warnings:
            self.warnings.append(message)
            self.emit("warning", **message.to_dict())
            self.say(f"warning: {message}")

    def scene(self, lines: list[Message]) -> None:
        """Send all sentences on the scene so far: what the photos show, and what is left out and why."""
        self.emit("scene", lines=[line.to_dict() for line in lines])

    def done(self, asset: Path) -> None:
        """Send that the asset is complete."""
        self.emit("done", asset=str(asset))
        self.say(f"done: {asset}")

    def error(self, error: NepError) -> None:
        """Send that the job failed."""
        self.emit("error", **error.to_dict())
        self.say(f"error: {error.message}", *(f"       {line}" for line in error.hint.split("\n") if error.hint))

    def close(self) -> None:
        """Close the progress bar and the log."""
        if self._bar is not None:
            self._bar.close()
            self._bar = None
        if self._log is not None:
            with contextlib.suppress(OSError):
                self._log.close()
            self._log = None
