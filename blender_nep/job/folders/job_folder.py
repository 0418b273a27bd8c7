"""The folder `job/` of an asset. It belongs to one run at a time.

    lock           locked as long as the engine runs; the operating system unlocks it, however the engine ends

With `--job-files`, another program follows a run by the other files, finds it again, and stops it:

    job.json       id, host, pid, start, arguments; written last: when it is there, the other files are there too
    events.jsonl   the events, one JSON object a line
    engine.log     what the engine and its libraries print
    stop           another program makes this file; then the run writes its checkpoint and ends
    preview.*      what has been learned so far (`--preview`)

The folder describes only the last run. A resume does not need it, and the asset does not need it.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import socket
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from blender_nep.errors import OutputError, UsageError
from blender_nep.files import open_in_place, output_error, output_errors, refuse_links, write_atomically

FOLDER = "job"
PREVIEW_MESH, PREVIEW_PICTURE = "preview.npz", "preview.png"
_NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP)
_PAUSE_S = 0.5
_IN_USE_HINT = "Stop it or wait for its end, or choose another --out."
_LOCK = "lock"
_FILES = ("job.json", "events.jsonl", "engine.log", "stop", PREVIEW_MESH, PREVIEW_PICTURE)


def was_used(asset: Path) -> bool:
    """Whether a run or a correction was at work in the folder `asset`: then its job folder holds an empty file `lock`."""
    return is_lock(asset / FOLDER / _LOCK)


def is_lock(path: Path) -> bool:
    """Whether there is a file `path` that `lock_file` may have made."""
    return path.is_file() and not path.is_symlink() and path.stat().st_size == 0


def refuse_foreign_files(asset: Path) -> None:
    """Raises UsageError where the folder `job` holds files that a run would remove, and no run of ours has made it."""
    path = asset / FOLDER
    found = [name for name in (_LOCK, *_FILES) if os.path.lexists(path / name)]
    if found and not was_used(asset):
        raise UsageError(
            f"{path} holds {found[0]}, and nothing shows that blender-nep has written that",
            "Choose another --out, or move that folder away.",
            "usage.not_ours",
            folder=path,
            files=found[0],
        )


class Journal:
    """A file to which lines are appended. Lines that a full disk does not take are kept and written later, in order."""

    def __init__(self, path: Path) -> None:
        self._descriptor = open_in_place(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND)
        self._waiting = b""

    def write(self, text: str) -> None:
        """Take a line. `flush` writes it to the file."""
        self._waiting += text.encode()

    def flush(self) -> None:
        """Write as many of the waiting lines as the disk takes."""
        with contextlib.suppress(OSError):
            while self._waiting:
                self._waiting = self._waiting[os.write(self._descriptor, self._waiting) :]


class JobFolder:
    """The job folder of a run that begins now. The folder belongs to the run until `close`, or until the process ends."""

    def __init__(self, asset: Path, *, followed: bool) -> None:
        """Lock the folder, and remove the files of an earlier run. `followed`: another program will follow this one.

        Raises UsageError while another run or a correction owns the folder, or where it is not ours, and OutputError when it
        cannot be written. Some network drives know no locks. There a run that is not followed goes without one.
        """
        self.path = asset / FOLDER
        with output_errors(self.path):
            refuse_links(asset, [FOLDER])
            refuse_foreign_files(asset)
            self.path.mkdir(parents=True, exist_ok=True)
            self._lock = lock_file(self.path / _LOCK, asset, needed=followed)
            for name in _FILES:
                (self.path / name).unlink(missing_ok=True)

    def close(self) -> None:
        """Let another run have the folder."""
        os.close(self._lock)

    def journal(self) -> Journal:
        """The file for the events of the run. Raises OutputError."""
        with output_errors(self.path):
            return Journal(self.path / "events.jsonl")

    @property
    def stop_file(self) -> Path:
        """The path of the file that asks the run to stop. Another program makes it."""
        return self.path / "stop"

    def describe(self, **what: str) -> None:
        """Write job.json with the id, host, pid, start and arguments, and the texts `what`. Raises OutputError."""
        job = {
            "id": f"{time.time_ns():x}-{os.getpid()}",
            "host": socket.gethostname(),
            "pid": os.getpid(),
            "started": time.strftime("%Y-%m-%d %H:%M:%S"),
            "arguments": sys.argv[1:],
            **what,
        }
        text = json.dumps(job, indent=1)
        write_atomically(self.path / "job.json", lambda file: file.write_text(text, encoding="utf-8"))

    def take_stderr(self) -> None:
        """Send everything that is printed to stderr from now on to engine.log. Raises OutputError.

        The program that started this process may end before the run does, so nobody may be there to read stderr.
        """
        with output_errors(self.path):
            sys.stderr.flush()
            log = open_in_place(self.path / "engine.log", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
            os.dup2(log, 2)
            os.close(log)


@contextlib.contextmanager
def held(asset: Path) -> Iterator[None]:
    """Lock the job folder of a finished run, so that no run and no other correction begins there.

    Its files stay. A folder that holds no asset is not locked. Raises UsageError while another one owns the folder, and
    OutputError when it cannot be written.
    """
    path = asset / FOLDER / _LOCK
    if not (asset / "report.json").is_file():
        yield
        return
    with output_errors(path):
        refuse_links(asset, [FOLDER])
        path.parent.mkdir(exist_ok=True)
        hint = "Stop it or wait for its end, then correct the materials again."
        descriptor = lock_file(path, asset, needed=False, hint=hint)
    try:
        yield
    finally:
        os.close(descriptor)


def is_held(asset: Path) -> bool:
    """Whether a run or a correction is at work in the folder. False where the file system knows no locks."""
    path = asset / FOLDER / _LOCK
    if not path.is_file():
        return False
    try:
        os.close(lock_file(path, asset, needed=False))
    except UsageError:
        return True
    except (OSError, OutputError):
        return False
    return False


def wait_until_free(asset: Path, longest_s: float) -> None:
    """Wait until no run and no correction is at work in the folder, for at most `longest_s` seconds."""
    until = time.monotonic() + longest_s
    while is_held(asset) and time.monotonic() < until:
        time.sleep(_PAUSE_S)


def lock_file(
    path: Path, folder: Path, *, needed: bool = True, holder: str = "another run or correction", hint: str = _IN_USE_HINT
) -> int:
    """Lock the file `path` and return its descriptor. Raises UsageError while another process holds the lock, OutputError.

    Where the file system knows no locks, that is an error only if the lock is `needed`. The UsageError says that `holder` is
    at work in `folder`: the lock itself does not tell a run from a correction. `hint` says what to do then.

    A program that follows the run locks the file for an instant, to see whether the run lives. So the lock is tried again.
    """
    descriptor = open_in_place(path, os.O_RDWR | os.O_CREAT)
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
            if error.errno in _NO_LOCKS and not needed:
                return descriptor
            if error.errno not in (errno.EAGAIN, errno.EACCES, errno.EWOULDBLOCK):
                os.close(descriptor)
                raise output_error(path, error) from error
            time.sleep(0.01 * (attempt > 0))
    os.close(descriptor)
    raise UsageError(f"{holder} is at work in {folder}", hint, "usage.folder_in_use", folder=folder)
