"""The folders that the artist's settings name."""

import os
from pathlib import Path

import bpy

SAVE_FILE_FIRST = "Save the file first: its folders are relative to it"


def resolve_folder(setting: str) -> Path | None:
    """The absolute path of the folder in a setting.

    None where the setting is empty, and where it is relative to a .blend file that is not saved yet.
    """
    if not setting or (setting.startswith("//") and not bpy.data.is_saved):
        return None
    return Path(bpy.path.abspath(setting))


def folder_key(folder: Path) -> str:
    """One string for all ways to write the path of the same folder."""
    return os.path.normcase(os.path.abspath(folder))
