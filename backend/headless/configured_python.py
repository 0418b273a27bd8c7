"""Which Python the add-on's preferences name for the engine."""


def configured_python() -> str:
    """The engine's Python from the add-on's preferences; empty where the add-on is not enabled in this Blender."""
    import bpy

    for name, addon in bpy.context.preferences.addons.items():
        if name.rpartition(".")[2] == "blender_nep":
            return getattr(addon.preferences, "engine_python", "")
    return ""
