"""Reads batch.json, the state of a batch (docs/conventions.md has its keys)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any

from blender_nep.errors import UsageError
from blender_nep.safety.folder_names import is_folder_name
from blender_nep.safety.plain_files import read_json

BATCH = "batch.json"
"""The file in the folder of a batch."""
FORMAT = 1
"""The version of its keys."""


class State(StrEnum):
    """The state of an object, as batch.json names it."""

    WAITING = "waiting"
    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"
    STOPPED = "stopped"


@dataclass(frozen=True)
class BatchObject:
    """One object of a batch."""

    name: str
    """The name of its folder"""
    state: State
    stage: str | None
    fraction: float
    """How much of the job is done, 0..1"""
    eta_s: float | None
    seconds: float | None
    peak_memory_mb: float | None
    warnings: tuple[str, ...]
    """In words"""
    error: str | None
    """What went wrong, in words"""
    hint: str
    """What to do about it, or nothing"""

    @classmethod
    def of(cls, told: Mapping[str, Any]) -> BatchObject:
        """The object from its entry in batch.json. Raises KeyError, TypeError or ValueError if the entry is damaged."""
        name = told["name"]
        if not is_folder_name(name):
            raise ValueError(f"{name!r} is not the name of a folder")
        error = told.get("error")
        return cls(
            name=name,
            state=State(told["state"]),
            stage=told.get("stage"),
            fraction=min(max(_number(told.get("fraction")) or 0.0, 0.0), 1.0),
            eta_s=_number(told.get("eta_s")),
            seconds=_number(told.get("seconds")),
            peak_memory_mb=_number(told.get("peak_memory_mb")),
            warnings=tuple(str(warning["message"]) for warning in told.get("warnings") or ()),
            error=str(error["message"]) if error else None,
            hint=str(error.get("hint") or "") if error else "",
        )


@dataclass(frozen=True)
class Batch:
    """A batch: what was asked for, and how far each object is."""

    preset: str
    started: str
    updated: str
    """ISO 8601"""
    objects: tuple[BatchObject, ...]


def read_batch(folder: Path) -> Batch:
    """The batch in `folder`. Raises UsageError if there is none, or if its file is damaged."""
    path = folder / BATCH
    try:
        told = read_json(path)
    except FileNotFoundError as error:
        hint = "Name the folder that blender-nep batch has written."
        raise UsageError(f"{folder} holds no batch: {BATCH} is missing", hint, "usage.no_batch", folder=folder) from error
    except (OSError, ValueError) as error:
        raise _damaged(path, error) from error
    if isinstance(told, dict) and told.get("format") != FORMAT:
        hint = "Use the version of blender_nep that wrote it."
        message = f"{path} was written by another version of blender_nep"
        raise UsageError(message, hint, "usage.batch_format", file=path)
    try:
        return Batch(
            preset=str(told["preset"]),
            started=str(told["started"]),
            updated=str(told["updated"]),
            objects=tuple(map(BatchObject.of, told["objects"])),
        )
    except (AttributeError, KeyError, TypeError, ValueError, OverflowError) as error:
        raise _damaged(path, error) from error


def _damaged(path: Path, error: Exception) -> UsageError:
    hint = "Start blender-nep batch again; it writes the file anew."
    reason = f"{type(error).__name__}: {error}"
    return UsageError(f"{path} cannot be read ({reason})", hint, "usage.batch_damaged", file=path, reason=reason)


def _number(value: Any) -> float | None:
    """The number, None where it is not finite."""
    return None if value is None or not math.isfinite(number := float(value)) else number
