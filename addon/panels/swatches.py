"""Colors as icons, for lists that show a color which nobody can change there."""

from collections.abc import Sequence

import bpy
import bpy.utils.previews
import numpy as np

from ...backend.scene_io.srgb import linear_to_srgb

SIZE = 32  # pixels of an icon's side

_icons: bpy.utils.previews.ImagePreviewCollection | None = None


def swatch_icon(color: Sequence[float]) -> int:
    """The identifier of an icon that is filled with this linear color [3]."""
    global _icons
    if _icons is None:
        _icons = bpy.utils.previews.new()
    shown = np.round(255 * linear_to_srgb(np.array(color[:], np.float64))).astype(int)
    name = "#{:02x}{:02x}{:02x}".format(*shown)
    if name not in _icons:
        icon = _icons.new(name)
        icon.icon_size = SIZE, SIZE
        icon.icon_pixels_float.foreach_set(np.tile(np.append(shown / 255, 1).astype(np.float32), SIZE * SIZE))
    return _icons[name].icon_id


def remove_all_swatches() -> None:
    """Blender or the add-on ends: give all icons back to Blender."""
    global _icons
    if _icons is not None:
        bpy.utils.previews.remove(_icons)
        _icons = None
