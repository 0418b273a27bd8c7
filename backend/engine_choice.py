"""Where the engine is, according to the add-on's preferences. The panel and the headless scripts ask the same question."""

from pathlib import Path

import bpy

from .engine.install import installed_python


def extension_folder(package: str) -> Path | None:
    """The folder for the extension's own files; None where the add-on is not installed as an extension."""
    try:
        return Path(bpy.utils.extension_path_user(package))
    except ValueError:
        return None


def engine_folder(preferences: bpy.types.AddonPreferences | None, package: str) -> Path | None:
    """The folder where *Install Engine* installs the engine; None where there is none."""
    # an older version of the add-on may lack these preferences
    if folder := getattr(preferences, "engine_folder", ""):
        return Path(bpy.path.abspath(folder))
    return extension_folder(package)


def engine_python(preferences: bpy.types.AddonPreferences | None, package: str) -> str:
    """The Python that the artist has chosen, else the Python of the installed engine, else an empty string."""
    if python := getattr(preferences, "engine_python", ""):
        return bpy.path.abspath(python)
    folder = engine_folder(preferences, package)
    return installed_python(folder) if folder is not None else ""
