"""Reads batch.json: what is known of all objects of a batch. No bpy in this file.

The engine writes the file (blender_nep/batch/state.py), each time as a whole, while the batch is at work, too.
"""

import functools
import hashlib
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...plain_files import MOST_JSON, read_bytes, read_json
from ..folder_names import is_folder_name
from .job_files import is_locked, make_file

FILE, LOCK, STOP_FILE = "batch.json", "batch.lock", "batch.stop"
"""In the folder of a batch: its state, what is locked as long as a batch is at work, and what asks that batch to stop"""
FORMAT = 1
WAITING, RUNNING, DONE, FAILED, STOPPED = STATES = ("waiting", "running", "done", "failed", "stopped")


@dataclass(frozen=True)
class BatchObject:
    """One object of a batch. `folder`: its asset. `capture`: the folder with its photos. `fraction`: 0..1."""

    name: str
    folder: Path
    capture: Path
    state: str
    fraction: float = 0.0
    message: str = ""
    """Why it has failed, and what to do, in the engine's own English"""
    hint: str = ""
    error: str = ""
    """The name of the error"""
    values: dict[str, Any] | None = None
    made: str = ""
    """Differs when the asset is made anew. Empty where it is not done, or not there"""


@dataclass(frozen=True)
class BatchFile:
    """A batch: its folder, when it was started for the first time, and its objects in their order."""

    folder: Path
    started: str
    preset: str
    objects: tuple[BatchObject, ...]

    def count(self, *states: str) -> int:
        """How many objects are in one of these states."""
        return sum(one.state in states for one in self.objects)

    @property
    def done(self) -> list[BatchObject]:
        """The objects that are done."""
        return [one for one in self.objects if one.state == DONE]

    @property
    def fraction(self) -> float:
        """The part of the batch that is done, 0..1. All objects count the same."""
        ended = (1.0 if one.state in (DONE, FAILED) else one.fraction for one in self.objects)
        return sum(ended) / max(len(self.objects), 1)


def has_batch(folder: Path) -> bool:
    """Whether the folder holds a batch."""
    return os.path.isfile(Path(folder) / FILE)  # False, too, where the folder cannot be read


def is_batch_running(folder: Path) -> bool:
    """Whether a batch is at work in the folder, whoever has started it."""
    return is_locked(Path(folder) / LOCK)


def ask_to_stop(folder: Path) -> None:
    """Ask the batch that is at work in the folder to stop. Raises OSError where the folder cannot be written."""
    make_file(Path(folder) / STOP_FILE)


def read_batch(folder: Path) -> BatchFile:
    """What batch.json says. Raises ValueError, with a message that says what to do, where there is none or it is damaged."""
    folder = Path(folder)
    path = folder / FILE
    try:
        content = read_json(path)
    except OSError as error:
        reason = error.strerror or str(error)
        raise ValueError(f"There is no batch in {folder} ({reason}). Choose the folder of a batch") from error
    except ValueError as error:
        raise ValueError(f"{path} is damaged. Start the batch again with Start All Again") from error
    try:
        if content["format"] != FORMAT:
            raise ValueError(f"{path} is of another version. Take the add-on and the engine of one version")
        objects = tuple(_object(folder, told) for told in content["objects"])
        return BatchFile(folder, str(content.get("started", "")), str(content.get("preset", "")), objects)
    except (KeyError, TypeError, AttributeError, OverflowError) as error:
        raise ValueError(f"{path} is damaged. Start the batch again with Start All Again") from error


def _object(folder: Path, told: dict[str, Any]) -> BatchObject:
    name, state = told["name"], told["state"]
    if state not in STATES or not is_folder_name(name):
        raise KeyError(name)
    asset, error = folder / name, told.get("error") or {}
    return BatchObject(
        name,
        asset,
        asset / "capture" if told.get("photos_alone") else Path(str(told["capture"])),
        state,
        min(max(float(told.get("fraction") or 0), 0.0), 1.0),
        str(error.get("message", "")),
        str(error.get("hint", "")),
        str(error.get("name", "")),
        error.get("values"),
        _made(asset) if state == DONE else "",
    )


def _made(asset: Path) -> str:
    """What tells the asset from the one that another job makes in the same folder, and not from a copy of it."""
    path = asset / "report.json"
    try:
        about = path.stat()
        return _digest(path, about.st_mtime_ns, about.st_size)
    except OSError:
        return ""


@functools.cache
def _digest(path: Path, _time: int, _size: int) -> str:
    """Of the content of a file. A file of the same time and size is not read again."""
    return hashlib.sha256(read_bytes(path, MOST_JSON)).hexdigest()[:16]
