"""Save As into another folder: paths that begin with `//` go on naming the same files and folders.

Blender does this for its own paths, as for those of images, and not for those of an add-on.
"""

import os
from pathlib import Path

import bpy
from bpy.app.handlers import persistent

from ..backend.scene_io.image_files import relative_path
from . import folder_changes
from .folders import folder_key

_changed: list[tuple[bpy.types.PropertyGroup, str, str]] = []
"""(settings, name, value before) of what was changed for the save under way. Nothing else can happen during a save."""


@persistent
def on_save_begins(path: str, *_: object) -> None:
    """Blender's handler before a file is saved at `path`: change the paths that would name other folders from there."""
    _changed.clear()
    before = bpy.data.filepath
    if not before or not path or _same_folder(path, before):
        return
    for settings, name in _path_settings():
        value = getattr(settings, name)
        if value.startswith("//"):
            _changed.append((settings, name, value))
            _change(settings, name, relative_path(bpy.path.abspath(value), os.path.dirname(path)))


@persistent
def on_save_ended(path: str, *_: object) -> None:
    """Blender's handler after a save, or after one that failed. After *Save Copy* the open file is where it was."""
    if not (bpy.data.filepath and path and _same_folder(path, bpy.data.filepath)):
        for settings, name, value in _changed:
            _change(settings, name, value)
    _changed.clear()


def _path_settings() -> list[tuple[bpy.types.PropertyGroup, str]]:
    """All settings of this file's scenes that name a file or a folder."""
    found = []
    for scene in bpy.data.scenes:
        if scene.library is None:
            for settings in (scene.nep, *scene.nep.shelf_captures):
                strings = (item for item in settings.bl_rna.properties if item.type == "STRING")
                found += [(settings, item.identifier) for item in strings if item.subtype in ("DIR_PATH", "FILE_PATH")]
    return found


def _same_folder(path: str, other: str) -> bool:
    return folder_key(Path(path).parent) == folder_key(Path(other).parent)


def _change(settings: bpy.types.PropertyGroup, name: str, value: str) -> None:
    with folder_changes.without_notices():  # the same folder gets another name
        setattr(settings, name, value)
