"""Errors with an exit code, one clear message, and a hint on what to do.

docs/conventions.md#exit-codes says what each code means. Code 8 is missing here: it is of Blender's part.

Blender's Python does not import this package. `backend/engine/exit_codes.py` repeats the codes that the add-on needs.
"""

from __future__ import annotations

from typing import Any


class NepError(Exception):
    """An error for the user: `message` says in one line what is wrong, `hint` says what to do.

    `code` is the exit code. `name` (such as `output.disk_full`) and `values` are for programs that describe the error in
    words of their own, as Blender's panel does (`backend/engine/words.py`).
    """

    code = 1
    name = "unexpected"

    def __init__(self, message: str, hint: str = "", name: str = "", **values: Any) -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint
        self.name = name or type(self).name
        self.values = values

    def to_dict(self) -> dict[str, Any]:
        """The error as plain values, for the `error` event and `blender-nep info --json`."""
        return {"code": self.code, "name": self.name, "values": self.values, "message": self.message, "hint": self.hint}


class UsageError(NepError):
    """The arguments are wrong, or they do not fit the run that is there."""

    code = 2
    name = "usage"


class CaptureError(NepError):
    """The capture cannot be read, or is not usable."""

    code = 3
    name = "capture"


class BoundsError(NepError):
    """The bounding sphere of the object cannot be right."""

    code = 4
    name = "bounds"


class OutputError(NepError):
    """The asset cannot be written."""

    code = 5
    name = "output"


class LearningError(NepError):
    """Learning failed."""

    code = 6
    name = "learning"


class Stopped(NepError):
    """The job was stopped on request. The checkpoint was written, except after a second Ctrl-C."""

    code = 7
    name = "stopped"


class ObjectsFailed(NepError):
    """A batch has come to its end, but some of its objects have no asset."""

    code = 9
    name = "objects_failed"
