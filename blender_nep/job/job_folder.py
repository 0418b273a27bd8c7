"""`job/` in the asset folder: how another program follows a run, finds it again, and stops it (`--job-files`).

    lock           locked by the operating system for as long as the engine lives, however it dies
    job.json       id, pid, start, arguments; written last, so that what it describes is complete
    events.jsonl   the events, one JSON object a line
    engine.log     what the engine and its libraries print
    stop           whoever wants the run to write its checkpoint and end makes this file
    preview.*      what has been learned so far (`--preview`)

The folder describes one run, the last one; nothing in it is needed to resume or to use the asset.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import sys
import time
from pathlib import Path

from blender_nep.errors import UsageError
from blender_nep.files import output_error, output_errors, write_atomically

FOLDER = "job"
PREVIEW_MESH, PREVIEW_PICTURE = "preview.npz", "preview.png"
_FILES = ("job.json", "events.jsonl", "engine.log", "stop", PREVIEW_MESH, PREVIEW_PICTURE)


class Journal:
    """A file that lines are appended to and that outlives a full disk: what found no space is written later, in order."""

    def __init__(self, path: Path) -> None:
        flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND | getattr(os, "O_BINARY", 0)
        self._descriptor = os.open(path, flags, 0o666)
        self._waiting = b""

    def write(self, text: str) -> None:
        """Takes a line; `flush` writes it."""
        self._waiting += text.encode()

    def flush(self) -> None:
        """Writes as much as the disk takes."""
        with contextlib.suppress(OSError):
            while self._waiting:
                self._waiting = self._waiting[os.write(self._descriptor, self._waiting) :]


class JobFolder:
    """The folder of a run that begins now. It belongs to this process until that ends."""

    def __init__(self, asset: Path) -> None:
        """Take the folder and clear what an earlier run left. Raises UsageError while another run owns it, OutputError."""
        self.path = asset / FOLDER
        with output_errors(self.path):
            self.path.mkdir(parents=True, exist_ok=True)
            self._lock = _lock(self.path / "lock", asset)
            for name in _FILES:
                (self.path / name).unlink(missing_ok=True)
            self.journal = Journal(self.path / "events.jsonl")

    @property
    def stop_file(self) -> Path:
        """Its appearance is the wish to stop."""
        return self.path / "stop"

    def describe(self, **what: str) -> None:
        """Write job.json. Raises OutputError."""
        job = {
            "id": f"{time.time_ns():x}-{os.getpid()}",
            "pid": os.getpid(),
            "started": time.strftime("%Y-%m-%d %H:%M:%S"),
            "arguments": sys.argv[1:],
            **what,
        }
        text = json.dumps(job, indent=1)
        write_atomically(self.path / "job.json", lambda file: file.write_text(text, encoding="utf-8"))

    def take_stderr(self) -> None:
        """What is printed from now on goes to engine.log: the program that started this one need not live to read it."""
        with output_errors(self.path):
            sys.stderr.flush()
            log = os.open(self.path / "engine.log", os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o666)
            os.dup2(log, 2)
            os.close(log)


def _lock(path: Path, asset: Path) -> int:
    """The descriptor of the locked file. A follower locks it for an instant to see whether we live: so try again."""
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
    for attempt in range(20):
        try:
            if sys.platform == "win32":
                import msvcrt

                msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
            else:
                import fcntl

                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return descriptor
        except OSError as error:
            if error.errno not in (errno.EAGAIN, errno.EACCES, errno.EWOULDBLOCK):
                os.close(descriptor)
                raise output_error(path, error) from error
            time.sleep(0.01 * (attempt > 0))
    os.close(descriptor)
    hint = "Stop it or wait for its end, or choose another --out."
    raise UsageError(f"another run is at work in {asset}", hint, "usage.folder_in_use", folder=asset)
