"""The operators of a shelf: reconstruct many objects, stop, bring the finished ones in, asset library, gallery."""

from pathlib import Path

import bpy

from ...backend.engine.command import EngineError, find_engine_python
from ...backend.engine.results.batch_file import BatchFile, has_batch, read_batch
from ...backend.shelf.bring_in import bring_in
from ..engine_errors import error_text
from ..engine_paths import engine_python
from ..folders import SAVE_FILE_FIRST, resolve_folder
from ..scene import shelf_scene
from ..tasks import registry
from ..tasks.gallery_pages import GalleryPages
from ..tasks.shelf_batch import batch_in, keep_failed_start, start_batch
from .confirmation import Asks

REPLACES_LISTED = "This replaces the results of all objects of the listed captures."
REPLACES_ALL = "This replaces the results of all objects in the folder."
NO_FOLDER = "Choose the folder of the shelf first"


def _folder(scene: bpy.types.Scene) -> Path | None:
    return resolve_folder(scene.nep.shelf_output)


class NEP_OT_add_shelf_captures(bpy.types.Operator):
    bl_idname = "nep.add_shelf_captures"
    bl_label = "Add Folder"
    bl_description = "Add a folder with captures: a capture, or a folder that holds captures or folders with photos"
    bl_options = {"REGISTER", "UNDO"}

    directory: bpy.props.StringProperty(name="Folder", subtype="DIR_PATH", options={"SKIP_SAVE"})

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        context.scene.nep.shelf_captures.add().path = self.directory
        return {"FINISHED"}


class NEP_OT_remove_shelf_captures(bpy.types.Operator):
    bl_idname = "nep.remove_shelf_captures"
    bl_label = "Remove Folder"
    bl_description = "Take this folder from the list; nothing is removed from the disk"
    bl_options = {"REGISTER", "UNDO"}

    index: bpy.props.IntProperty(name="Index", min=0)

    def execute(self, context: bpy.types.Context) -> set[str]:
        context.scene.nep.shelf_captures.remove(self.index)
        return {"FINISHED"}


class NEP_OT_reconstruct_shelf(Asks, bpy.types.Operator):
    bl_idname = "nep.reconstruct_shelf"
    bl_label = "Reconstruct Shelf"
    bl_description = (
        "Make a mesh with materials of each object, as many at once as this computer can. "
        "Started again, it goes on with what is left"
    )

    overwrite: bpy.props.BoolProperty(
        name="Overwrite", description="Start all objects again, also those that are done", options={"SKIP_SAVE"}
    )

    @classmethod
    def description(cls, context: bpy.types.Context, properties: bpy.types.OperatorProperties) -> str:
        return "Make all objects anew, also those that are done" if properties.overwrite else cls.bl_description

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        folder = _folder(context.scene)
        if folder is None:
            cls.poll_message_set(NO_FOLDER)
            return False
        if not batch_in(folder).ended:
            cls.poll_message_set("A batch is at work in this folder")
            return False
        if not _captures(context.scene) and not has_batch(folder):
            cls.poll_message_set("Add a folder with captures first")
            return False
        return True

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if self.overwrite:
            message = REPLACES_LISTED if _captures(context.scene) else REPLACES_ALL
            return self._ask(context, event, title="Start All Again", message=message)
        return self._start(context, wait=bpy.app.background)

    def execute(self, context: bpy.types.Context) -> set[str]:
        if self._is_double_click():
            return {"CANCELLED"}
        return self._start(context, wait=not self.options.is_invoke)  # is_invoke: the artist has confirmed the question

    def _start(self, context: bpy.types.Context, wait: bool) -> set[str]:
        settings, folder = context.scene.nep, _folder(context.scene)
        captures = _captures(context.scene)
        if None in captures:
            self.report({"ERROR"}, SAVE_FILE_FIRST)
            return {"CANCELLED"}
        try:
            batch = start_batch(
                find_engine_python(configured=engine_python(context)),
                captures,
                folder,
                keep_going=settings.closing == "KEEP",
                wait=wait,
                preset=settings.preset,
                device=settings.device,
                seed=settings.seed,
                masks="use" if settings.use_masks else "ignore",
                metal=settings.metal,
                turntable=settings.turntable,
                faces=settings.faces or None,
                all_photos=settings.all_photos,
                overwrite=self.overwrite,
            )
        except EngineError as error:
            return self._failed(keep_failed_start(folder, error))
        return {"FINISHED"} if batch.failed is None else self._failed(batch.failed)

    def _failed(self, error: EngineError) -> set[str]:
        self.report({"ERROR"}, error_text(error))
        return {"CANCELLED"}


def _captures(scene: bpy.types.Scene) -> list[Path | None]:
    """The chosen folders; None for one that is relative to a file that is not saved yet."""
    return [resolve_folder(entry.path) for entry in scene.nep.shelf_captures if entry.path]


class NEP_OT_stop_shelf(bpy.types.Operator):
    bl_idname = "nep.stop_shelf"
    bl_label = "Stop"
    bl_description = "Stop the batch; checkpoints are kept, so that Reconstruct Shelf goes on with what is left"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        folder = _folder(context.scene)
        batch = None if folder is None else batch_in(folder)
        if batch is None or batch.ended:
            cls.poll_message_set("No batch is at work in this folder")
            return False
        if batch.stopping:
            cls.poll_message_set("It is stopping already")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            batch_in(_folder(context.scene)).stop()
        except OSError as error:
            self.report({"ERROR"}, f"The batch cannot be asked to stop: {error}. Stop it where it was started")
            return {"CANCELLED"}
        return {"FINISHED"}


class BatchOperator:
    """An operator that needs the folder of a batch."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        folder = _folder(context.scene)
        if folder is None or not has_batch(folder):
            cls.poll_message_set(NO_FOLDER if folder is None else "There is no batch in this folder yet")
            return False
        if context.mode != "OBJECT":
            cls.poll_message_set("Leave Edit Mode first")
            return False
        return True


class NEP_OT_bring_in_objects(BatchOperator, bpy.types.Operator):
    bl_idname = "nep.bring_in_objects"
    bl_label = "Bring In Objects"
    bl_description = (
        "Import all finished objects that are not in the scene yet: in a row, each marked as an asset. "
        "Objects that were made anew get their new mesh and material. Also works while the batch is at work"
    )
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            batch: BatchFile = read_batch(_folder(context.scene))
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        manager = context.window_manager
        manager.progress_begin(0, max(len(batch.done), 1))
        found = bring_in(batch, context.scene, lambda number, _count: manager.progress_update(number))
        manager.progress_end()
        for name, reason in found.refused.items():
            self.report({"WARNING"}, f"{name} cannot be imported: {reason}")
        if not found.items and not found.renewed:
            self.report({"INFO"}, "No new objects: all that are done are in the scene")
            return {"FINISHED"} if not found.refused else {"CANCELLED"}
        problem = shelf_scene.write_catalogs_of_file()
        if problem:
            self.report({"WARNING"}, f"The catalog cannot be written: {problem}")
        shelf_scene.refresh_asset_browsers()
        told = {"Brought in": found.items, "Made anew": found.renewed}
        lines = [f"{what}: {', '.join(item.name for item in items)}" for what, items in told.items() if items]
        self.report({"INFO"}, ". ".join(lines))
        return {"FINISHED"}


class NEP_OT_add_asset_library(BatchOperator, bpy.types.Operator):
    bl_idname = "nep.add_asset_library"
    bl_label = "Add to Asset Libraries"
    bl_description = (
        "Save the objects as shelf.blend in the folder of the shelf, and make the folder an asset library, "
        "so that all scenes find them in the Asset Browser"
    )

    def execute(self, context: bpy.types.Context) -> set[str]:
        folder = _folder(context.scene)
        try:
            path = shelf_scene.write_shelf_file(read_batch(folder), context.scene)
        except (OSError, ValueError, RuntimeError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        if not shelf_scene.is_asset_library(folder):
            shelf_scene.add_asset_library(folder)
        shelf_scene.refresh_asset_browsers()
        self.report({"INFO"}, f"{path} is in the asset library {folder.name}")
        return {"FINISHED"}


class NEP_OT_open_gallery(BatchOperator, bpy.types.Operator):
    bl_idname = "nep.open_gallery"
    bl_label = "Open Gallery"
    bl_description = "Open the page with all objects in the web browser. The engine writes it first, which takes seconds"

    def execute(self, context: bpy.types.Context) -> set[str]:
        folder = _folder(context.scene)
        try:
            pages = GalleryPages(find_engine_python(configured=engine_python(context)), folder)
        except EngineError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        registry.start(pages, wait=bpy.app.background)
        return {"FINISHED"}


CLASSES = (
    NEP_OT_add_shelf_captures,
    NEP_OT_remove_shelf_captures,
    NEP_OT_reconstruct_shelf,
    NEP_OT_stop_shelf,
    NEP_OT_bring_in_objects,
    NEP_OT_add_asset_library,
    NEP_OT_open_gallery,
)
