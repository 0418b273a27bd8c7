"""The engine's look at the photos of a capture: from where they were taken, and what is wrong with them.

The result belongs to the capture's folder as it was then. It is forgotten when no scene names the folder any more, or when
the photos or the cameras in the folder have changed.
"""

from pathlib import Path
from typing import Any

import bpy

from ...backend.engine.commands.capture_query import CaptureQuery
from ...backend.engine.results.capture_facts import DISCS_ROWS
from ..capture_folder import forget_looks, last_look_into, look_into
from ..folders import folder_key, resolve_folder
from ..halved_pictures import load_picture, remove_picture
from . import registry
from .engine_task import QueryTask

PICTURE = "photo check"  # key of the picture of the photos' directions


class PhotoCheck(QueryTask):
    """A check. When it has ended, either `found` or `error` is set.

    `bounds`: arguments with the object's sphere, in place of the capture's own.
    """

    def __init__(self, folder: Path, engine_python: str, bounds: tuple[str, ...]) -> None:
        super().__init__(folder, CaptureQuery(folder, engine_python, picture=True, bounds=bounds))
        self._holds = look_into(folder)

    @property
    def found(self) -> dict[str, Any] | None:
        """What `blender_nep info --json` said."""
        return self.query.found

    @property
    def picture(self) -> Path | None:
        """The file of the picture; None where there is none."""
        file = self.query.picture
        return file if self.found is not None and file is not None and file.is_file() else None

    @property
    def is_of_today(self) -> bool:
        """Whether the folder holds the same photos and cameras as at the check."""
        return last_look_into(self.folder) == self._holds

    def finish(self) -> None:
        forget_looks()
        if self.picture is not None:
            load_picture(PICTURE, self.picture, rows=DISCS_ROWS)

    def close(self) -> None:
        super().close()
        remove_picture(PICTURE)


def last_check(folder: Path | None) -> PhotoCheck | None:
    """The last check of this folder as it is now; None where there is none."""
    check = None if folder is None else registry.ended(PhotoCheck, folder)
    return check if check is not None and check.is_of_today else None


def on_capture_chosen(_scene: bpy.types.Scene) -> None:
    """A scene names another capture folder: a check of a folder that no scene names is of no use any more."""
    folders = [resolve_folder(scene.nep.capture) for scene in bpy.data.scenes]
    named = {folder_key(folder) for folder in folders if folder is not None}
    for check in registry.tasks_of(PhotoCheck):
        if check.key not in named:
            registry.forget(check)
