"""The engine's look at the photos of a capture: from where they were taken, and what is wrong with them.

The result belongs to the capture's folder as it was then. It is forgotten when no scene names the folder any more, or when
the photos or the cameras in the folder have changed.
"""

from pathlib import Path
from typing import Any

import bpy
from bpy.app.handlers import persistent

from ...backend.engine.command import EngineError
from ...backend.engine.commands.capture_query import CaptureQuery
from ...backend.engine.results.capture_facts import DISCS_ROWS
from ..capture_folder import forget_looks, last_look_into, look_into
from ..folders import folder_key, resolve_folder
from ..halved_pictures import load_picture, remove_picture
from . import clock

PICTURE = "photo check"  # key of the picture of the photos' directions


class PhotoCheck:
    """A check that is under way, or has ended; `clock.follow` follows it. Then either `found` or `error` is set."""

    def __init__(self, folder: Path, engine_python: str, bounds: tuple[str, ...]) -> None:
        self.folder = folder
        self._holds = look_into(folder)
        self._query = CaptureQuery(folder, engine_python, picture=True, bounds=bounds)

    @property
    def found(self) -> dict[str, Any] | None:
        """What `blender_nep info --json` said."""
        return self._query.found

    @property
    def error(self) -> EngineError | None:
        return self._query.error

    @property
    def picture(self) -> Path | None:
        """The file of the picture; None where there is none."""
        file = self._query.picture
        return file if self.found is not None and file is not None and file.is_file() else None

    @property
    def is_of_today(self) -> bool:
        """Whether the folder holds the same photos and cameras as at the check."""
        return last_look_into(self.folder) == self._holds

    def poll(self) -> bool:
        """Whether the engine has answered."""
        return self._query.poll()

    def displayed_state(self) -> None:
        """The sidebar shows only that the check is under way, and nothing that changes."""

    def finish(self) -> None:
        """Keep the result for the panel. A check that was cancelled leaves none."""
        global current, _last
        if current is not self:
            return
        current, _last = None, self
        forget_looks()
        if self.picture is not None:
            load_picture(PICTURE, self.picture, rows=DISCS_ROWS)

    def close(self) -> None:
        """Do not wait for the engine any more, and remove the picture's file."""
        self._query.close()


current: PhotoCheck | None = None  # the check under way
_last: PhotoCheck | None = None  # the last one that has ended


def start_check(folder: Path, engine_python: str, bounds: tuple[str, ...], *, wait: bool) -> PhotoCheck:
    """Let the engine look at the capture. `bounds`: arguments with the object's sphere, in place of the capture's own.

    With `wait` this function returns after that; else it returns at once.
    """
    global current
    _forget_last()
    check = current = PhotoCheck(folder, engine_python, bounds)
    clock.follow(check, wait=wait)
    return check


def cancel() -> None:
    """End the check under way, if there is one. It leaves no result."""
    global current
    if current is not None:
        current.close()
    current = None


def is_at_work_in(folder: Path) -> bool:
    """Whether this folder is being checked."""
    return current is not None and folder_key(current.folder) == folder_key(folder)


def last_check(folder: Path | None) -> PhotoCheck | None:
    """The last check of this folder as it is now; None where there is none."""
    if _last is None or folder is None or folder_key(_last.folder) != folder_key(folder):
        return None
    return _last if _last.is_of_today else None


def on_capture_chosen(_scene: bpy.types.Scene) -> None:
    """A scene names another capture folder: a check of a folder that no scene names is of no use any more."""
    folders = [resolve_folder(scene.nep.capture) for scene in bpy.data.scenes]
    named = {folder_key(folder) for folder in folders if folder is not None}
    if _last is not None and folder_key(_last.folder) not in named:
        _forget_last()
    if current is not None and folder_key(current.folder) not in named:
        cancel()


@persistent
def on_file_loaded(*_: object) -> None:
    """Blender's handler after another file was opened: its scenes have other captures."""
    close_all()


def close_all() -> None:
    """Blender or the add-on ends: forget all checks."""
    cancel()
    _forget_last()


def _forget_last() -> None:
    global _last
    if _last is not None:
        _last.close()
        remove_picture(PICTURE)
    _last = None
