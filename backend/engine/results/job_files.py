"""Reads those files of an output folder that Blender needs: the files of the job, its checkpoints, the finished asset.

The engine writes `OUT/job/`; blender_nep/job/folders/job_folder.py lists its files. No bpy in this file.
"""

import errno
import os
import sys
from pathlib import Path

from ...plain_files import open_plain, parse_json, read_json

FOLDER = "job"
_MOST_AT_ONCE = 16 << 20
"""Bytes of events that are read at a time"""
TEXTURE_NAMES = ("albedo", "roughness", "metallic", "confidence")
"""Every texture of an asset: a second copy of `TEXTURES` in blender_nep/asset/export.py, which Blender's Python does not
import. A test compares the two."""


def is_asset(out: Path) -> bool:
    """Whether the folder holds a finished asset. The engine writes report.json last."""
    needed = ("mesh.obj", *(f"textures/{name}.exr" for name in TEXTURE_NAMES), "report.json")
    return all(os.path.isfile(Path(out) / name) for name in needed)  # False, too, where the folder cannot be read


def has_checkpoint(out: Path) -> bool:
    """Whether the folder holds an unfinished run that can be resumed."""
    return os.path.isfile(Path(out) / "checkpoints" / "run.json") and not os.path.isfile(Path(out) / "report.json")


def read_job(out: Path) -> dict | None:
    """The content of job.json (id, pid, preset, ...) of the last job in the folder; None where there was no job."""
    try:
        job = read_json(Path(out) / FOLDER / "job.json")
    except (OSError, ValueError):
        return None
    return job if isinstance(job, dict) and isinstance(job.get("pid"), int) else None


def is_running(out: Path) -> bool:
    """Whether an engine is at work in the folder.

    A running engine holds a lock on a file. The operating system releases the lock when the engine ends, for any reason.
    """
    return is_locked(Path(out) / FOLDER / "lock")


def is_locked(path: Path) -> bool:
    """Whether a running engine holds the lock on this file. False where there is no such file."""
    try:
        descriptor = os.open(path, os.O_RDWR | getattr(os, "O_NONBLOCK", 0))
    except OSError:
        return False
    try:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
            msvcrt.locking(descriptor, msvcrt.LK_UNLCK, 1)
        else:
            import fcntl

            fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError as error:  # some network drives know no locks, and say so by other errors
        return error.errno in (errno.EAGAIN, errno.EACCES, errno.EWOULDBLOCK)
    finally:
        os.close(descriptor)  # releases the lock
    return False


def make_file(path: Path) -> None:
    """Make an empty file, or leave the one that is there. Raises OSError, also where a link is there: it leads elsewhere."""
    if os.path.islink(path):
        raise OSError(errno.ELOOP, os.strerror(errno.ELOOP), str(path))
    path.touch()


class EventFile:
    """Reads the events that another process appends to a file as JSON lines. Lines that are no events are left out."""

    def __init__(self, path: Path):
        self.path = path
        self._position = 0
        self._begun = b""  # the first part of a line whose end is not written yet

    def read(self) -> list[dict]:
        """The events that were added since the last call; an empty list where the file cannot be read."""
        try:
            with open_plain(self.path, sys.maxsize) as file:
                file.seek(self._position)
                new = file.read(_MOST_AT_ONCE)
        except OSError:
            return []
        self._position += len(new)
        *lines, begun = (self._begun + new).split(b"\n")
        self._begun = begun if len(begun) <= _MOST_AT_ONCE else b""  # an event is not so long
        return [event for event in map(_event, lines) if event]


def _event(line: bytes) -> dict | None:
    try:
        event = parse_json(line)
    except ValueError:
        return None
    return event if isinstance(event, dict) and "event" in event else None


def last_lines(path: Path, count: int) -> str:
    """The last `count` lines of a text file, at most 8 KB; an empty string where the file cannot be read."""
    try:
        with open_plain(path, sys.maxsize) as file:
            file.seek(max(0, os.fstat(file.fileno()).st_size - 8192))
            return "\n".join(file.read().decode("utf-8", "replace").splitlines()[-count:])
    except OSError:
        return ""
