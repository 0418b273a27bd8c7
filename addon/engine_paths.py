"""Where the engine and its files are, according to the add-on's preferences."""

import sys
from pathlib import Path

import bpy

from ..backend.engine.install import installed_python

EXTENSION_PACKAGE = __package__.rpartition(".")[0]  # the name by which Blender lists the extension


def addon_preferences(context: bpy.types.Context) -> bpy.types.AddonPreferences | None:
    """The add-on's NepPreferences; None where the add-on is registered without being in Blender's list."""
    addon = context.preferences.addons.get(EXTENSION_PACKAGE)
    return addon.preferences if addon else None


def extension_folder() -> Path | None:
    """The folder for the extension's own files; None where the add-on is not installed as an extension."""
    try:
        return Path(bpy.utils.extension_path_user(EXTENSION_PACKAGE))
    except ValueError:
        return None


def timings_file() -> Path:
    """The file that remembers how long the last jobs took."""
    return (extension_folder() or Path(bpy.utils.user_resource("CONFIG"))) / "nep_timings.json"


def engine_folder(context: bpy.types.Context) -> Path | None:
    """The folder where the engine is installed, or would be; None where there is none."""
    preferences = addon_preferences(context)
    if preferences is not None and preferences.engine_folder:
        return Path(bpy.path.abspath(preferences.engine_folder))
    return extension_folder()


def base_python(context: bpy.types.Context) -> str:
    """The Python that makes the engine's environment."""
    preferences = addon_preferences(context)
    if preferences is not None and preferences.base_python:
        return bpy.path.abspath(preferences.base_python)
    return sys.executable


def torch_build(context: bpy.types.Context) -> str:
    """The build of torch to install: "cpu" or "cuda"."""
    preferences = addon_preferences(context)
    return preferences.build if preferences is not None else "cpu"


def engine_python(context: bpy.types.Context) -> str:
    """The Python that the artist has chosen, else the Python of the installed engine, else an empty string."""
    preferences = addon_preferences(context)
    if preferences is not None and preferences.engine_python:
        return bpy.path.abspath(preferences.engine_python)
    folder = engine_folder(context)
    return installed_python(folder) if folder is not None else ""
