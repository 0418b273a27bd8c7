"""The add-on's preferences: whether the engine is there, which Python runs it, and where it is installed."""

import sys
from pathlib import Path

import bpy

from ..backend.engine.install import NAME, installed_python

ROOT_PACKAGE = __package__.rpartition(".")[0]
BUILDS = (
    ("cpu", "CPU", "For every computer; the smallest download (about 1 GB on the disk)"),
    (
        "cuda",
        "CUDA",
        "For NVIDIA graphics cards, on Linux (several GB). On Windows install torch as pytorch.org says, "
        "and choose that Python as Engine Python",
    ),
)


class NepPreferences(bpy.types.AddonPreferences):
    bl_idname = ROOT_PACKAGE

    engine_python: bpy.props.StringProperty(
        name="Engine Python",
        subtype="FILE_PATH",
        description="The Python that has blender-nep and torch. Empty: the installed engine. Never Blender's own",
    )
    engine_folder: bpy.props.StringProperty(
        name="Install Into",
        subtype="DIR_PATH",
        description=f"The engine is made in the folder {NAME} in there. Empty: the extension's own user folder",
    )
    base_python: bpy.props.StringProperty(
        name="Base Python",
        subtype="FILE_PATH",
        description="The Python 3.11 or newer that makes the engine's environment. Empty: Blender's own",
    )
    build: bpy.props.EnumProperty(name="Build of Torch", description="What the engine can compute on", items=BUILDS)

    def draw(self, context):
        from . import engine_setup

        engine_setup.draw(self.layout, self)


def of(context) -> NepPreferences | None:
    """The add-on's preferences; None where it runs without being in Blender's list."""
    addon = context.preferences.addons.get(ROOT_PACKAGE)
    return addon.preferences if addon else None


def user_folder() -> Path | None:
    """Where files of the extension live; None where it is not installed as one."""
    try:
        return Path(bpy.utils.extension_path_user(ROOT_PACKAGE))
    except ValueError:
        return None


def timings_file() -> Path:
    """What the last jobs took."""
    return (user_folder() or Path(bpy.utils.user_resource("CONFIG"))) / "nep_timings.json"


def engine_folder(context) -> Path | None:
    """Where the engine is installed, or would be."""
    chosen = of(context)
    if chosen is not None and chosen.engine_folder:
        return Path(bpy.path.abspath(chosen.engine_folder))
    return user_folder()


def base_python(context) -> str:
    """The Python that makes the engine's environment."""
    chosen = of(context)
    return bpy.path.abspath(chosen.base_python) if chosen is not None and chosen.base_python else sys.executable


def engine_python(context) -> str:
    """The Python that the artist has named, else that of the installed engine, else an empty string."""
    chosen = of(context)
    if chosen is not None and chosen.engine_python:
        return bpy.path.abspath(chosen.engine_python)
    folder = engine_folder(context)
    return installed_python(folder) if folder is not None else ""
