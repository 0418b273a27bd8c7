"""The result in the scene."""
from pathlib import Path

import bpy

from ..backend.asset_import import import_asset
from ..backend.world import build_world
from . import jobs, settings


class NEP_OT_import_result(bpy.types.Operator):
    bl_idname = "nep.import_result"
    bl_label = "Import Result"
    bl_description = "Bring the reconstructed object into the scene, with its material and the light around it"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012

    folder: bpy.props.StringProperty(name="Folder", description="Asset folder; empty: the scene's output folder")

    def execute(self, context):
        folder = Path(self.folder) if self.folder else settings.folder(context.scene.nep.output)
        if folder is None:
            self.report({"ERROR"}, "Choose an output folder first")
            return {"CANCELLED"}
        try:
            item = import_asset(folder, context.scene.collection)
            build_world(folder / "environment.exr", name=f"{item.name} light")
        except OSError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        jobs.note_import(context.scene, folder)
        self.report({"INFO"}, f"Imported {item.name}; its light is the World '{item.name} light'")
        return {"FINISHED"}
