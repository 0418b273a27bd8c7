"""The operators of a result: import it, and light the scene with the recovered light."""

import bpy

from ..folders import resolve_folder
from ..scene import lit_view
from ..scene.imported_result import is_lit, is_recovered_light_used, place_result, relink, result_object, switch_light

IMPORT_FIRST = "Import a result first: its light comes with it"


class NEP_OT_import_result(bpy.types.Operator):
    bl_idname = "nep.import_result"
    bl_label = "Import Result"
    bl_description = (
        "Import a finished reconstruction into the active collection: the object in place with its material, and the "
        "recovered light as a World. Importing it again makes another object with the same images and World"
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
            item = place_result(context.scene, folder, _active_collection(context))
        except OSError as error:
            self.report({"ERROR"}, f"The result cannot be imported: {error}")
            return {"CANCELLED"}
        self.report({"INFO"}, f"Imported {item.name}; its light is the World '{context.scene.nep.recovered_world.name}'")
        return {"FINISHED"}


def _active_collection(context: bpy.types.Context) -> bpy.types.Collection | None:
    """The collection into which new objects come; None where it is linked from a library and cannot take them."""
    return context.collection if context.collection is not None and context.collection.is_editable else None


class NEP_OT_relink_result(bpy.types.Operator):
    bl_idname = "nep.relink_result"
    bl_label = "Relink"
    bl_description = (
        "Choose the folder of the imported result again, after it was renamed or moved. The object keeps its corrections"
    )
    bl_options = {"REGISTER", "UNDO"}

    directory: bpy.props.StringProperty(name="Folder", subtype="DIR_PATH", options={"SKIP_SAVE"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not context.scene.nep.asset:
            cls.poll_message_set("Import a result first")
            return False
        return True

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        folder = resolve_folder(self.directory)
        if folder is None:
            self.report({"ERROR"}, "Choose the folder of the result")
            return {"CANCELLED"}
        try:
            relink(context.scene, folder)
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, f"The result is now {folder.name}")
        return {"FINISHED"}


class OfRecoveredLight:
    """For operators that need the World of an imported result."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if context.scene.nep.recovered_world is None:
            cls.poll_message_set(IMPORT_FIRST)
            return False
        return True


class NEP_OT_use_recovered_light(OfRecoveredLight, bpy.types.Operator):
    bl_idname = "nep.use_recovered_light"
    bl_label = "Use Recovered Light"
    bl_description = "Light the scene with the World that was recovered from the photos; press again for your own World"
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        scene, shown = context.scene, lit_view.viewport(context)
        switch_light(scene)
        if shown is not None and not is_recovered_light_used(scene):
            lit_view.shading_back(*shown)
        if is_recovered_light_used(scene):
            self.report({"INFO"}, f"The recovered light: {scene.world.name}")
        else:
            self.report({"INFO"}, f"Your own World: {scene.world.name if scene.world else 'none'}")
        return {"FINISHED"}


class NEP_OT_show_lit(OfRecoveredLight, bpy.types.Operator):
    bl_idname = "nep.show_lit"
    bl_label = "Show Lit"
    bl_description = (
        "See the object as in the photos: the recovered light, your lamps off, the viewport in Material Preview or Rendered "
        "with the scene's World, the object alone and framed. Press again for your own light, lamps and shading"
    )
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        scene, shown = context.scene, lit_view.viewport(context)
        if is_lit(scene, shown):
            lit_view.lamps_back(scene)
            if shown is not None:
                lit_view.shading_back(*shown)
            switch_light(scene)
            self.report({"INFO"}, "Your own light, lamps and shading")
            return {"FINISHED"}
        if not is_recovered_light_used(scene):
            switch_light(scene)
        count = lit_view.lamps_off(scene)
        item = result_object(scene)
        if shown is not None:
            lit_view.show_world(*shown)
            if item is not None:
                lit_view.show_alone(*shown, item)
                lit_view.frame_object(shown[1], item)
        self.report({"INFO"}, f"The recovered light: {scene.world.name}. Lamps turned off: {count}")
        return {"FINISHED"}


CLASSES = (NEP_OT_import_result, NEP_OT_use_recovered_light, NEP_OT_show_lit, NEP_OT_relink_result)
