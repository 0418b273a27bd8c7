"""The operators of a result: import it, and light the scene with the recovered light."""

import bpy

from ..folders import resolve_folder
from ..scene.imported_result import is_recovered_light_used, place_result, switch_light


class NEP_OT_import_result(bpy.types.Operator):
    bl_idname = "nep.import_result"
    bl_label = "Import Result"
    bl_description = (
        "Import a finished reconstruction: the object in place with its material, and the recovered light "
        "as a World. Importing it again makes another object"
    )
    bl_options = {"REGISTER", "UNDO"}

    folder: bpy.props.StringProperty(
        name="Folder",
        description="Asset folder; empty: the scene's output folder",
        subtype="DIR_PATH",
        options={"SKIP_SAVE"},
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if context.mode != "OBJECT":
            cls.poll_message_set("Leave Edit Mode first")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        folder = resolve_folder(self.folder or context.scene.nep.output)
        if folder is None:
            self.report({"ERROR"}, "Choose the output folder of a reconstruction first")
            return {"CANCELLED"}
        try:
            item = place_result(context.scene, folder)
        except OSError as error:
            self.report({"ERROR"}, f"The result cannot be imported: {error}")
            return {"CANCELLED"}
        self.report({"INFO"}, f"Imported {item.name}; its light is the World '{context.scene.nep.recovered_world.name}'")
        return {"FINISHED"}


class NEP_OT_use_recovered_light(bpy.types.Operator):
    bl_idname = "nep.use_recovered_light"
    bl_label = "Use Recovered Light"
    bl_description = "Light the scene with the World that was recovered from the photos; press again for your own World"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if context.scene.nep.recovered_world is None:
            cls.poll_message_set("Import a result first: its light comes with it")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        scene = context.scene
        switch_light(scene)
        if is_recovered_light_used(scene):
            self.report({"INFO"}, f"The recovered light: {scene.world.name}")
        else:
            self.report({"INFO"}, f"Your own World: {scene.world.name if scene.world else 'none'}")
        return {"FINISHED"}


CLASSES = (NEP_OT_import_result, NEP_OT_use_recovered_light)
