"""Where the engine and its files are, according to the add-on's preferences."""

import sys
from pathlib import Path

import bpy

from ..backend import engine_choice

EXTENSION_PACKAGE = __package__.rpartition(".")[0]  # the name by which Blender lists the extension


def addon_preferences(context: bpy.types.Context) -> bpy.types.AddonPreferences | None:
    """The add-on's NepPreferences; None where the add-on is registered without being in Blender's list."""
    addon = context.preferences.addons.get(EXTENSION_PACKAGE)
    return addon.preferences if addon else None


def timings_file() -> Path:
    """The file that remembers how long the last jobs took."""
    return (
        engine_choice.extension_folder(EXTENSION_PACKAGE) or Path(bpy.utils.user_resource("CONFIG"))
    ) / "nep_timings.json"


def engine_folder(context: bpy.types.Context) -> Path | None:
    """The folder where the engine is installed, or would be; None where there is none."""
    return engine_choice.engine_folder(addon_preferences(context), EXTENSION_PACKAGE)


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
    return engine_choice.engine_python(addon_preferences(context), EXTENSION_PACKAGE)
