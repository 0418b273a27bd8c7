"""The add-on's preferences: which Python runs the engine."""
import bpy

ROOT_PACKAGE = __package__.rpartition(".")[0]


class NepPreferences(bpy.types.AddonPreferences):
    bl_idname = ROOT_PACKAGE

    engine_python: bpy.props.StringProperty(
        name="Engine Python",
        description="The Python that has blender-nep and torch. Empty: search for one. Never Blender's own",
        subtype="FILE_PATH",
    )

    def draw(self, context):
        self.layout.prop(self, "engine_python")


def engine_python(context) -> str:
    """The path set by the artist, or an empty string (also where the add-on runs without being in the preferences)."""
    addon = context.preferences.addons.get(ROOT_PACKAGE)
    path = addon.preferences.engine_python if addon and addon.preferences else ""
    return bpy.path.abspath(path) if path else ""
