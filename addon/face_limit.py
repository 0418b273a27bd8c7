"""The least number of faces that an artist can ask for. No bpy in this file, for the reason that folder_changes.py tells."""

from typing import Any

from ..backend.engine.command import LEAST_FACES


def keep_enough_faces(settings: Any, _context: Any) -> None:
    """What Blender calls after `scene.nep.faces` has changed: 0 stays, and all other numbers become LEAST_FACES at least."""
    if 0 < settings.faces < LEAST_FACES:
        settings.faces = LEAST_FACES
