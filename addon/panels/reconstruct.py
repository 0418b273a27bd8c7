"""The sidebar's main panel: the settings of a job, the progress of a running job, and how the last job ended."""

import bpy
from bpy.app.translations import pgettext_iface

from ...backend.engine.command import NoEngineError, engine_is_at_hand
from ...backend.engine.progress import duration
from ...backend.engine.results.job_files import has_checkpoint, is_asset
from ...backend.engine.timings import GUESS, THESE_PHOTOS, THIS_COMPUTER, expected_seconds
from ..capture_folder import last_look_into
from ..engine_paths import engine_python, timings_file
from ..folders import resolve_folder
from ..properties import NepSettings
from ..scene.imported_result import has_new_result, is_lit, result_object
from ..scene.lit_view import viewport
from ..tasks import registry
from ..tasks.running_jobs import Job, job_of
from ..wrapped_text import draw_setting, draw_steady, draw_wrapped, fitting
from .camera_search import draw_camera_search
from .pictures import draw_halves

STOPPING = "Stopping: writing the checkpoint"
TIMES = {
    THESE_PHOTOS: "{time}, as measured with these photos",
    THIS_COMPUTER: "{time} for these photos, by the last jobs here",
    GUESS: "{time}: a guess until the first job has ended",
}


class NEP_PT_reconstruct(bpy.types.Panel):
    bl_label = "Reconstruct Glossy Object"
    bl_idname = "NEP_PT_reconstruct"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "NeP"

    def draw(self, context: bpy.types.Context) -> None:
        self.layout.use_property_split = True
        self.layout.use_property_decorate = False
        job = job_of(context.scene)
        if job is not None and not job.ended:
            _draw_running(self.layout, context, job)
            _draw_other_jobs(self.layout, job)
            return
        _draw_settings(self.layout, context)
        _draw_engine(self.layout, context)
        if job is not None:
            _draw_end(self.layout, context, job)
        _draw_buttons(self.layout, context)
        if job is not None:
            _draw_scene_analysis(self.layout, context, job)
        _draw_other_jobs(self.layout, job)


def _draw_settings(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    settings = context.scene.nep
    draw_setting(layout, context, settings, "capture", placeholder="Photos")
    draw_camera_search(layout, context)
    draw_setting(layout, context, settings, "output", placeholder="Result")
    draw_setting(layout, context, settings, "preset")
    draw_wrapped(layout, context, _expected_time(settings), "TIME")
    draw_setting(layout, context, settings, "use_masks")
    draw_setting(layout, context, settings, "device")
    header, body = layout.panel("nep_advanced", default_closed=True)
    header.label(text="Advanced")
    if body is not None:
        column = body.column(align=True)
        column.label(text="When Blender closes:")
        column.prop(settings, "closing", text="")
        for name in ("metal", "turntable", "all_photos", "faces", "use_preview", "seed", "threads", "mesh"):
            draw_setting(body, context, settings, name)


def _expected_time(settings: NepSettings) -> str:
    """How long a job takes with the chosen photos and preset, and where that is known from."""
    capture = resolve_folder(settings.capture)
    photos = 0 if capture is None else last_look_into(capture).photos
    expected = expected_seconds(timings_file(), settings.preset, capture, photos)
    text = pgettext_iface(TIMES[expected.basis])
    return text.format(time=duration(expected.seconds, pgettext_iface))


def _draw_engine(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Where no engine is installed: a hint, and the button to the preferences."""
    if engine_is_at_hand(engine_python(context)):
        return
    draw_wrapped(layout, context, "The engine is not set up yet: it is installed once, from the preferences.", "INFO")
    layout.operator("nep.open_preferences", icon="PREFERENCES")


def _draw_buttons(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    scene = context.scene
    output = resolve_folder(scene.nep.output)
    finished, unfinished = output is not None and is_asset(output), output is not None and has_checkpoint(output)
    column = layout.column()
    column.scale_y = 1.4
    if finished and has_new_result(scene):
        column.operator("nep.import_result", icon="IMPORT").folder = str(output)
    if unfinished:
        column.operator("nep.reconstruct", text="Resume", icon="PLAY").resume = True
    if not (finished or unfinished):
        column.operator("nep.reconstruct", text=fitting(context, "Reconstruct Glossy Object", "Reconstruct"), icon="PLAY")
        return
    row = layout.row(align=True)
    if finished and not has_new_result(scene):
        again = fitting(context, "Import Again", "Import", parts=2)
        row.operator("nep.import_result", text=again, icon="IMPORT").folder = str(output)
    row.operator(
        "nep.reconstruct", text=fitting(context, "Start Again", "Again", parts=2), icon="FILE_REFRESH"
    ).overwrite = True


def _draw_running(layout: bpy.types.UILayout, context: bpy.types.Context, job: Job) -> None:
    """The bar, with Cancel below it. What changes its length stands below both, so that no button moves under the mouse."""
    layout.label(text=job.folder.name, icon="FILE_FOLDER")
    progress = job.progress
    layout.progress(factor=progress.fraction, text=f"{100 * progress.fraction:.0f} %")
    row = layout.row(align=True)
    row.operator("nep.cancel", icon="CANCEL")
    row.operator("nep.open_log", text="", icon="TEXT")
    draw_steady(layout, context, [pgettext_iface(STOPPING)] if job.stopping else progress.lines(pgettext_iface))
    _draw_picture(layout, context, job)
    for warning in job.warnings[-2:]:
        draw_wrapped(layout, context, warning.words(pgettext_iface), "INFO")
    _draw_scene_analysis(layout, context, job)


def _draw_scene_analysis(layout: bpy.types.UILayout, context: bpy.types.Context, job: Job) -> None:
    """What the photos show, and what the engine leaves out because of it.

    This box stands below all buttons: its length changes, and a button must not move under the mouse.
    """
    if not job.scene_analysis:
        return
    header, body = layout.panel("nep_scene", default_closed=True)
    header.label(text=fitting(context, "What the Photos Show", "Photos Show"))
    if body is not None:
        for line in job.scene_analysis:
            draw_wrapped(body, context, line.words(pgettext_iface))


def _draw_other_jobs(layout: bpy.types.UILayout, shown: Job | None) -> None:
    """The running jobs of other scenes, files and output folders. They stand below all buttons, because they come and go."""
    for job in registry.tasks_of(Job):
        if job is not shown and not job.ended:
            layout.progress(factor=job.done_fraction, text=f"{job.folder.name}: {100 * job.done_fraction:.0f} %")


def _draw_picture(layout: bpy.types.UILayout, context: bpy.types.Context, job: Job) -> None:
    """The photo beside what was learned of it, as wide as the sidebar allows."""
    draw_halves(layout, context, job.key, ("Photo", "Learned so far"))


def _draw_end(layout: bpy.types.UILayout, context: bpy.types.Context, job: Job) -> None:
    failed = job.failed
    if failed is None:
        text = (
            "The result is ready. Import Result brings it into the scene."
            if has_new_result(context.scene)
            else "The object is in the scene."
        )
        draw_wrapped(layout, context, text, "CHECKMARK")
        if result_object(context.scene) is not None:
            layout.operator("nep.show_lit", icon="SHADING_RENDERED", depress=is_lit(context.scene, viewport(context)))
        for warning in job.warnings[-2:]:
            draw_wrapped(layout, context, warning.words(pgettext_iface), "INFO")
        return
    message, hint = failed.words(pgettext_iface)
    draw_wrapped(layout, context, message, "PAUSE" if job.was_stopped else "ERROR")
    draw_wrapped(layout, context, hint, "BLANK1")
    if isinstance(failed, NoEngineError):
        layout.operator("nep.open_preferences", icon="PREFERENCES")
    elif not job.was_stopped:
        layout.operator("nep.open_log", icon="TEXT")
