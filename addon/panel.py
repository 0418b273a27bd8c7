"""The sidebar panel: what to reconstruct, how far it is, what came of it."""

import bpy
from bpy.app.translations import pgettext_iface

from ..backend.engine.command import NoEngineError, engine_is_at_hand
from ..backend.engine.job_files import has_checkpoint, is_asset
from ..backend.engine.progress import duration
from ..backend.engine.timings import expected_seconds
from . import jobs, live_preview, preferences, settings
from .messages import inner_width, say

UNIT = 20  # pixels of a row at a scale of 1


class NEP_PT_reconstruct(bpy.types.Panel):
    bl_label = "Reconstruct Glossy Object"
    bl_idname = "NEP_PT_reconstruct"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "NeP"

    def draw(self, context):
        self.layout.use_property_split = True
        self.layout.use_property_decorate = False
        job = jobs.of(context.scene)
        if job is not None and not job.ended:
            _draw_running(self.layout, context, job)
            return
        _draw_settings(self.layout, context)
        _draw_engine(self.layout, context)
        if job is not None:
            _draw_end(self.layout, context, job)
        _draw_buttons(self.layout, context.scene)
        if job is not None:
            _draw_scene(self.layout, context, job)


def _draw_settings(layout, context) -> None:
    chosen = context.scene.nep
    layout.prop(chosen, "capture", placeholder="Folder with the photos")
    layout.prop(chosen, "output", placeholder="Folder for the result")
    layout.prop(chosen, "preset")
    seconds, measured = expected_seconds(preferences.timings_file(), chosen.preset)
    text = duration(seconds, pgettext_iface)
    row = layout.row()
    row.alignment = "RIGHT"
    row.label(text=f"{text} on this machine" if measured else f"{text} for 60 small photos", icon="TIME")
    layout.prop(chosen, "use_masks")
    layout.prop(chosen, "device")
    header, body = layout.panel("nep_advanced", default_closed=True)
    header.label(text="Advanced")
    if body is not None:
        column = body.column(align=True)
        column.label(text="When Blender closes:")
        column.prop(chosen, "closing", text="")
        for name in ("metal", "use_preview", "seed", "threads", "mesh"):
            body.prop(chosen, name)


def _draw_engine(layout, context) -> None:
    """What an artist has to do once, before the first job."""
    if engine_is_at_hand(preferences.engine_python(context)):
        return
    say(layout, context, "The engine is not set up yet: it is installed once, from the preferences.", "INFO")
    layout.operator("nep.open_preferences", icon="PREFERENCES")


def _draw_buttons(layout, scene) -> None:
    output = settings.folder(scene.nep.output)
    finished, unfinished = output is not None and is_asset(output), output is not None and has_checkpoint(output)
    column = layout.column()
    column.scale_y = 1.4
    if finished and jobs.result_waits(scene):
        column.operator("nep.import_result", icon="IMPORT").folder = str(output)
    if unfinished:
        column.operator("nep.reconstruct", text="Resume", icon="PLAY").resume = True
    if not (finished or unfinished):
        column.operator("nep.reconstruct", icon="PLAY")
        return
    row = layout.row(align=True)
    if finished and not jobs.result_waits(scene):
        row.operator("nep.import_result", text="Import Again", icon="IMPORT").folder = str(output)
    row.operator("nep.reconstruct", text="Start Again", icon="FILE_REFRESH").overwrite = True


def _draw_running(layout, context, job) -> None:
    layout.label(text=job.output.name, icon="FILE_FOLDER")
    progress = job.progress
    layout.progress(factor=progress.fraction, text=f"{100 * progress.fraction:.0f} %")
    column = layout.column(align=True)
    for line in ["Stopping: writing the checkpoint"] if job.stopping else progress.lines(pgettext_iface):
        column.label(text=line)
    _draw_picture(layout, context, live_preview.picture_icons(job.key))
    for warning in job.warnings[-2:]:
        say(layout, context, warning.words(pgettext_iface), "INFO")
    row = layout.row(align=True)
    row.operator("nep.cancel", icon="CANCEL")
    row.operator("nep.open_log", text="", icon="TEXT")
    _draw_scene(layout, context, job)


def _draw_scene(layout, context, job) -> None:
    """What the photos show, and what the engine leaves out because of it. Below all buttons, since its length changes."""
    if not job.scene:
        return
    header, body = layout.panel("nep_scene", default_closed=True)
    header.label(text="What the Photos Show")
    if body is not None:
        for line in job.scene:
            say(body, context, line.words(pgettext_iface))


def _draw_picture(layout, context, icons: list[int]) -> None:
    """The photo beside what was learned of it, as wide as the sidebar allows."""
    row = layout.row()
    for icon, title in zip(icons, ("Photo", "Learned so far"), strict=False):
        column = row.column(align=True)
        column.template_icon(icon, scale=max(3, inner_width(context) / len(icons) / UNIT))
        column.label(text=title)


def _draw_end(layout, context, job) -> None:
    failed = job.failed
    if failed is None:
        text = (
            "The result is ready. Import Result brings it into the scene."
            if jobs.result_waits(context.scene)
            else "The object is in the scene."
        )
        say(layout, context, text, "CHECKMARK")
        for warning in job.warnings[-2:]:
            say(layout, context, warning.words(pgettext_iface), "INFO")
        return
    message, hint = failed.words(pgettext_iface)
    say(layout, context, message, "PAUSE" if job.was_stopped else "ERROR")
    say(layout, context, hint, "BLANK1")
    if isinstance(failed, NoEngineError):
        layout.operator("nep.open_preferences", icon="PREFERENCES")
    elif not job.was_stopped:
        layout.operator("nep.open_log", icon="TEXT")
