"""Which Python the add-on's preferences name for the engine, or where the add-on has installed one."""

from pathlib import Path

from ..engine.install import installed_python


def configured_python() -> str:
    """The engine's Python that the add-on's preferences name, or else the one that *Install Engine* has made.

    Empty where there is neither, and where the add-on is not enabled in this Blender.
    """
    import bpy

    for name, addon in bpy.context.preferences.addons.items():
        if name.rpartition(".")[2] != "blender_nep":
            continue
        if python := getattr(addon.preferences, "engine_python", ""):
            return bpy.path.abspath(python)
        folder = getattr(addon.preferences, "engine_folder", "")
        try:
            return installed_python(Path(bpy.path.abspath(folder) if folder else bpy.utils.extension_path_user(name)))
        except ValueError:  # the add-on is not installed as an extension
            return ""
    return ""
