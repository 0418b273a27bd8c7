"""Which Python runs the engine, according to the add-on's preferences."""


def configured_python() -> str:
    """The engine's Python that the add-on's preferences name, or else the one that *Install Engine* has made.

    Empty where there is neither, and where the add-on is not enabled in this Blender.
    """
    import bpy

    from ..engine_choice import engine_python

    for name, addon in bpy.context.preferences.addons.items():
        if name.rpartition(".")[2] == "blender_nep":
            return engine_python(addon.preferences, name)
    return ""
