"""Pictures in the panel that consist of two halves side by side.

Blender shows a picture in a panel as a square. Two halves are then larger than the whole.
"""

from pathlib import Path

import bpy
import bpy.utils.previews
import numpy as np

HALVES = ("/left", "/right")  # added to the key of a picture: the names of its halves

_pictures: bpy.utils.previews.ImagePreviewCollection | None = None


def load_picture(key: str, file: Path, *, rows: tuple[float, float] = (0.0, 1.0)) -> None:
    """Load a picture, in place of an earlier one with the same key.

    `rows`: from which to which part of its height, from the top, it is shown. An unreadable file gives no picture.
    """
    global _pictures
    if _pictures is None:
        _pictures = bpy.utils.previews.new()
    remove_picture(key)
    both = _pictures.load(key, str(file), "IMAGE", force_reload=True)
    width, height = both.image_size
    if not width:
        return
    pixels = np.empty(4 * width * height, np.float32)
    both.image_pixels_float.foreach_get(pixels)
    top, bottom = (round(part * height) for part in rows)
    shown = pixels.reshape(height, width, 4)[height - bottom : height - top]  # row 0 is the lowest one
    halves = np.split(shown[:, : width // 2 * 2], 2, axis=1)
    for name, half in zip(HALVES, halves, strict=True):
        picture = _pictures.new(key + name)
        picture.image_size = half.shape[1], half.shape[0]
        picture.image_pixels_float.foreach_set(half.ravel())


def picture_halves(key: str) -> list[bpy.types.ImagePreview]:
    """The left and the right half of a picture; an empty list where no picture with this key is loaded."""
    if _pictures is None or key + HALVES[-1] not in _pictures:
        return []
    return [_pictures[key + name] for name in HALVES]


def remove_picture(key: str) -> None:
    """Remove the picture, if there is one."""
    if _pictures is not None:
        for name in ("", *HALVES):
            _pictures.pop(key + name, None)


def remove_all_pictures() -> None:
    """Blender or the add-on ends: give all pictures back to Blender."""
    global _pictures
    if _pictures is not None:
        bpy.utils.previews.remove(_pictures)
        _pictures = None
