"""The engine's estimate of the object's bounds, while it is under way and when it has come."""

from pathlib import Path

import bpy
from bpy.app.handlers import persistent

from ...backend.engine.command import EngineError
from ...backend.engine.commands.capture_query import CaptureQuery
from ..folders import folder_key, resolve_folder
from ..scene.object_bounds import place_bounds
from . import clock
from .opened_file import opened_file


class BoundsEstimate:
    """An estimate that is under way; `clock.follow` follows it. When it comes, it is placed in its scene."""

    def __init__(self, scene: bpy.types.Scene, capture: Path, engine_python: str) -> None:
        self._file, self._scene_name, self._capture = opened_file(), scene.name, capture
        self._query = CaptureQuery(capture, engine_python)

    def poll(self) -> bool:
        """Whether the engine has answered."""
        return self._query.poll()

    def displayed_state(self) -> None:
        """The sidebar shows only that the estimate is under way, and nothing that changes."""

    def finish(self) -> None:
        """Place the bounds. Nothing is placed where the scene is gone, or has another capture by now."""
        global current, last_error
        current = None
        self._query.close()
        if opened_file() != self._file:
            return
        last_error = self._query.error
        scene = bpy.data.scenes.get(self._scene_name)
        capture = None if scene is None else resolve_folder(scene.nep.capture)
        if self._query.sphere is None or capture is None or folder_key(capture) != folder_key(self._capture):
            return
        place_bounds(scene, self._capture, *self._query.sphere)
        if not bpy.app.background:
            bpy.ops.ed.undo_push(message="Propose Bounds")

    def close(self) -> None:
        """Do not wait for the engine any more."""
        self._query.close()


current: BoundsEstimate | None = None  # the estimate under way
last_error: EngineError | None = None  # why the last estimate failed; None where it did not


def forget_last_error() -> None:
    """A new proposal begins: the panel no longer shows why the last one failed."""
    global last_error
    last_error = None


@persistent
def on_file_loaded(*_: object) -> None:
    """Blender's handler after another file was opened: the error is one of the file before."""
    forget_last_error()


def start_estimate(scene: bpy.types.Scene, capture: Path, engine_python: str, *, wait: bool) -> None:
    """Ask the engine for the bounds of the capture's object, and place them in the scene when they come.

    With `wait` this function returns after that; else it returns at once.
    """
    global current
    forget_last_error()
    current = BoundsEstimate(scene, capture, engine_python)
    clock.follow(current, wait=wait)


def close_all() -> None:
    """Blender or the add-on ends: forget the estimate under way."""
    global current
    if current is not None:
        current.close()
    current = None
    forget_last_error()
