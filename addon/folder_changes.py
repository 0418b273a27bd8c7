"""Who is told when a scene names another output folder or another capture folder. No bpy in this file.

Blender keeps the functions below until its end, and they keep everything that this file has imported. If bpy were among it,
the bpy wheel 4.2 could not be taken apart in order, and would end with a segmentation fault.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

output_callbacks: list[Callable[[Any], None]] = []
"""Functions that are called with the scene. The add-on clears both lists at its end."""
capture_callbacks: list[Callable[[Any], None]] = []
"""As `output_callbacks`, for the capture folder."""
_told = True


@contextmanager
def without_notices() -> Iterator[None]:
    """Within this context a setting may get another name for the same folder, and no function is called."""
    global _told
    _told = False
    try:
        yield
    finally:
        _told = True


def notify_output(settings: Any, _context: Any) -> None:
    """What Blender calls after `scene.nep.output` has changed; `settings` is `scene.nep`."""
    for callback in output_callbacks if _told else ():
        callback(settings.id_data)


def notify_capture(settings: Any, _context: Any) -> None:
    """The same for `scene.nep.capture`."""
    for callback in capture_callbacks if _told else ():
        callback(settings.id_data)
