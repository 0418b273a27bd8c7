"""The result in the artist's scene: importing an asset, and the recovered light as the scene's World."""

from pathlib import Path

import bpy

from ..backend.scene_io.result import import_result
from . import jobs
from .settings import folder as folder_of


def place_result(scene, folder: Path):
    """Import the asset in `folder` into `scene`, its light as a World at hand; returns the object. OSError as there."""
    settings = scene.nep
    item, world = import_result(folder, scene.collection, pack=settings.images == "PACKED")
    settings.recovered_world, settings.asset = world, str(folder)
    layer = scene.view_layers[0]
    for other in layer.objects.selected:
        other.select_set(False, view_layer=layer)
    item.select_set(True, view_layer=layer)
    layer.objects.active = item
    return item


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
    def poll(cls, context):
        if context.mode != "OBJECT":
            cls.poll_message_set("Leave Edit Mode first")
            return False
        return True

    def execute(self, context):
        folder = folder_of(self.folder or context.scene.nep.output)
        if folder is None:
            self.report({"ERROR"}, "Choose the output folder of a reconstruction first")
            return {"CANCELLED"}
        try:
            item = place_result(context.scene, folder)
        except OSError as error:
            self.report({"ERROR"}, f"The result cannot be imported: {error}")
            return {"CANCELLED"}
        jobs.note_import(context.scene, folder)
        self.report({"INFO"}, f"Imported {item.name}; its light is the World '{context.scene.nep.recovered_world.name}'")
        return {"FINISHED"}


def light_is_used(scene) -> bool:
    """Whether the recovered light shines in the scene."""
    return scene.nep.recovered_world is not None and scene.world == scene.nep.recovered_world


class NEP_OT_use_recovered_light(bpy.types.Operator):
    bl_idname = "nep.use_recovered_light"
    bl_label = "Use Recovered Light"
    bl_description = "Light the scene with the World that was recovered from the photos; press again for your own World"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context):
        if context.scene.nep.recovered_world is None:
            cls.poll_message_set("Import a result first: its light comes with it")
            return False
        return True

    def execute(self, context):
        scene, settings = context.scene, context.scene.nep
        if light_is_used(scene):
            scene.world, settings.own_world = settings.own_world, None
            self.report({"INFO"}, f"Your own World: {scene.world.name if scene.world else 'none'}")
        else:
            settings.own_world, scene.world = scene.world, settings.recovered_world
            self.report({"INFO"}, f"The recovered light: {scene.world.name}")
        return {"FINISHED"}


CLASSES = (NEP_OT_import_result, NEP_OT_use_recovered_light)
