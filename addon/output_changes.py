"""Who is told when a scene names another output folder. No bpy in this file.

Blender keeps `tell` until its end, and `tell` keeps everything that this file has imported. If bpy were among it, the bpy
wheel 4.2 could not be taken apart in order, and would end with a segmentation fault.
"""

from collections.abc import Callable
from typing import Any

callbacks: list[Callable[[Any], None]] = []
"""Functions that are called with the scene. The add-on clears the list at its end."""


def tell(settings: Any, _context: Any) -> None:
    """What Blender calls after `scene.nep.output` has changed; `settings` is `scene.nep`."""
    for callback in callbacks:
        callback(settings.id_data)
