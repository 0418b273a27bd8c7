"""The sub-panel of a shelf: many captures, the batch that makes their assets, and the finished objects."""

from dataclasses import replace

import bpy
from bpy.app.translations import pgettext_iface

from ...backend.engine.results.batch_file import DONE, FAILED, RUNNING, STOPPED, WAITING, BatchObject
from ...backend.engine.words import BATCH_HINTS, error_words
from ..folders import resolve_folder
from ..scene import shelf_scene
from ..tasks.shelf_batch import ShelfBatch, batch_in
from ..wrapped_text import draw_setting, draw_wrapped, fitting
from .failure import draw_failure
from .subpanels import SubPanel

COUNTS = "{done} of {count} done, {failed} failed"
ELSEWHERE = "Started elsewhere: it goes on when Blender closes"
STOPPING = "Stopping: writing the checkpoints"
READY = "New objects: {count}"
UNSAVED = "Save the file: then the Asset Browser shows the objects in their catalog."
COUNTED = "batch.progress"  # the code of the engine's note that counts the objects
MOST_ROWS = 12
AND_MORE = "and {count} more"
ICONS = {WAITING: "TIME", RUNNING: "PLAY", DONE: "CHECKMARK", FAILED: "ERROR", STOPPED: "PAUSE"}
WORDS = {WAITING: "waiting", DONE: "done", FAILED: "failed", STOPPED: "stopped"}


class NEP_PT_shelf(SubPanel, bpy.types.Panel):
    bl_label = "Shelf: Many Objects"
    bl_idname = "NEP_PT_shelf"
    bl_options = {"DEFAULT_CLOSED"}
    bl_order = 5

    def draw(self, context: bpy.types.Context) -> None:
        layout, scene = self.layout, context.scene
        folder = resolve_folder(scene.nep.shelf_output)
        batch = None if folder is None else batch_in(folder)
        running = batch is not None and not batch.ended
        _draw_captures(layout, context, enabled=not running)
        column = layout.column()
        column.use_property_split, column.use_property_decorate = True, False
        draw_setting(column, context, scene.nep, "shelf_output", placeholder="Folder for all results")
        if not running:
            draw_setting(column, context, scene.nep, "preset")
        if batch is None:
            layout.operator("nep.reconstruct_shelf", icon="PLAY")
            return
        if running:
            _draw_progress(layout, context, batch)
        else:
            _draw_start(layout, batch)
            if batch.failed is not None:
                draw_failure(layout, context, batch.failed)
        if batch.file is not None:
            _draw_objects(layout, context, batch)
        elif batch.problem:
            draw_wrapped(layout, context, batch.problem, "ERROR")


def _draw_captures(layout: bpy.types.UILayout, context: bpy.types.Context, *, enabled: bool) -> None:
    settings = context.scene.nep
    column = layout.column(align=True)
    column.enabled = enabled
    for index, entry in enumerate(settings.shelf_captures):
        row = column.row(align=True)
        row.prop(entry, "path", text="", placeholder="Folder with captures")
        row.operator("nep.remove_shelf_captures", text="", icon="X").index = index
    text = fitting(context, "Add Folder with Captures", "Add Folder", "Add")
    column.operator("nep.add_shelf_captures", text=text, icon="ADD")


def _draw_start(layout: bpy.types.UILayout, batch: ShelfBatch) -> None:
    row = layout.row(align=True)
    row.scale_y = 1.4
    row.operator("nep.reconstruct_shelf", icon="PLAY")
    if batch.file is not None or batch.problem:
        row.operator("nep.reconstruct_shelf", text="", icon="FILE_REFRESH").overwrite = True


def _draw_progress(layout: bpy.types.UILayout, context: bpy.types.Context, batch: ShelfBatch) -> None:
    """The bar, with Stop beside it, and the time left. A batch that was started elsewhere does not tell the time left."""
    progress = None if batch.process is None else batch.process.progress
    fraction = progress.fraction if progress is not None else batch.file.fraction if batch.file is not None else 0.0
    row = layout.split(factor=0.7, align=True)
    row.progress(factor=fraction, text=f"{100 * fraction:.0f} %")
    row.operator("nep.stop_shelf")
    if batch.stopping:
        draw_wrapped(layout, context, STOPPING)
    elif progress is None:
        draw_wrapped(layout, context, pgettext_iface(ELSEWHERE))
    else:  # without what the list says
        without = replace(progress, note=None, steps=0) if progress.note and progress.note.code == COUNTED else progress
        draw_wrapped(layout, context, "\n".join(without.lines(pgettext_iface)))


def _draw_objects(layout: bpy.types.UILayout, context: bpy.types.Context, batch: ShelfBatch) -> None:
    """The objects: those at work and those that failed first. Then what can be done with the finished ones."""
    missing = shelf_scene.count_missing(batch.file, context.scene)
    column = layout.column()
    row = column.row()
    row.scale_y = 1.4
    row.operator("nep.bring_in_objects", icon="IMPORT")
    text = fitting(context, "Add to Asset Libraries", "Asset Library")
    column.operator("nep.add_asset_library", text=text, icon="ASSET_MANAGER")
    column.operator("nep.open_gallery", icon="URL")
    if missing:
        layout.label(text=pgettext_iface(READY).format(count=missing), icon="INFO")
    elif not bpy.data.is_saved and batch.file.done:
        draw_wrapped(layout, context, pgettext_iface(UNSAVED), "INFO")
    draw_wrapped(layout, context, batch.gallery_problem, "ERROR")
    objects = batch.file.objects
    counts = {"done": batch.file.count(DONE), "count": len(objects), "failed": batch.file.count(FAILED)}
    box = layout.box().column(align=True)
    box.label(text=pgettext_iface(COUNTS).format(**counts))
    order = {RUNNING: 0, FAILED: 1, STOPPED: 2, WAITING: 3, DONE: 4}
    for one in sorted(objects, key=lambda one: order[one.state])[:MOST_ROWS]:
        _draw_object(box, context, one)
    if len(objects) > MOST_ROWS:
        box.label(text=pgettext_iface(AND_MORE).format(count=len(objects) - MOST_ROWS), icon="BLANK1")


def _draw_object(layout: bpy.types.UILayout, context: bpy.types.Context, one: BatchObject) -> None:
    row = layout.split(factor=0.55)
    row.label(text=one.name, icon=ICONS[one.state])
    if one.state == RUNNING:
        row.progress(factor=one.fraction, text=f"{100 * one.fraction:.0f} %")
        return
    row.label(text=WORDS[one.state])
    if one.state == FAILED and one.message:
        message, hint = error_words(one.error, one.values or {}, one.message, one.hint, pgettext_iface, BATCH_HINTS)
        draw_wrapped(layout, context, f"{message}. {hint}", "BLANK1")


CLASSES = (NEP_PT_shelf,)
