"""The engine's estimate of the object's bounds, while it is under way and when it has come."""

from pathlib import Path

import bpy

from ...backend.engine.commands.capture_query import CaptureQuery
from ..folders import folder_key, resolve_folder
from ..scene.object_bounds import place_bounds
from .engine_task import QueryTask


class BoundsEstimate(QueryTask):
    """An estimate. When it comes, it is placed in its scene."""

    def __init__(self, scene: bpy.types.Scene, capture: Path, engine_python: str) -> None:
        super().__init__(capture, CaptureQuery(capture, engine_python))
        self._scene_name = scene.name

    def finish(self) -> None:
        """Place the bounds. Nothing is placed where the scene is gone, or has another capture by now."""
        scene = bpy.data.scenes.get(self._scene_name)
        capture = None if scene is None else resolve_folder(scene.nep.capture)
        if self.query.sphere is None or capture is None or folder_key(capture) != self.key:
            return
        place_bounds(scene, self.folder, *self.query.sphere)
        if not bpy.app.background:
            bpy.ops.ed.undo_push(message="Propose Bounds")
