"""The operators of a job: start or resume it, cancel it, read its log.

A button starts the job and returns: running_jobs.py then follows it. A script (`bpy.ops.nep.reconstruct(...)`) waits
until the object is in the scene.
"""

import os
from pathlib import Path

import bpy

from ...backend.engine.command import EngineError, find_engine_python, reconstruct_arguments
from ...backend.engine.engine import Engine
from ...backend.engine.results.job_files import FOLDER, has_checkpoint, is_asset, is_running
from ..editors import open_editor
from ..engine_paths import engine_python
from ..folders import SAVE_FILE_FIRST, resolve_folder
from ..properties import PRESETS
from ..scene.object_bounds import bounds_arguments, bounds_warning
from ..tasks import clock, registry
from ..tasks.camera_search import why_not_usable
from ..tasks.material_correction import MaterialCorrection
from ..tasks.running_jobs import Job, import_job_result, job_of
from .confirmation import Asks

LOG_LETTERS = 200_000  # of the end of each log file


class NEP_OT_reconstruct(Asks, bpy.types.Operator):
    bl_idname = "nep.reconstruct"
    bl_label = "Reconstruct Glossy Object"
    bl_description = "Make a mesh with materials, and the light around it, from the photos of the capture folder"

    # SKIP_SAVE: a button must not begin with what another button of this operator has set
    capture: bpy.props.StringProperty(
        name="Capture", description="Capture folder; empty: the scene's setting", options={"SKIP_SAVE"}
    )
    output: bpy.props.StringProperty(
        name="Output", description="Result folder; empty: the scene's setting", options={"SKIP_SAVE"}
    )
    preset: bpy.props.EnumProperty(
        name="Preset",
        description="How much time to spend",
        default="SCENE",
        items=(("SCENE", "As in the scene", "The scene's setting"), *PRESETS),
        options={"SKIP_SAVE"},
    )
    resume: bpy.props.BoolProperty(
        name="Resume", description="Go on from the checkpoint in the output folder", options={"SKIP_SAVE"}
    )
    overwrite: bpy.props.BoolProperty(
        name="Overwrite", description="Replace what is in the output folder", options={"SKIP_SAVE"}
    )
    wait: bpy.props.BoolProperty(
        name="Wait", description="In a script: return when the object is there", default=True, options={"SKIP_SAVE"}
    )

    @classmethod
    def description(cls, context: bpy.types.Context, properties: bpy.types.OperatorProperties) -> str:
        if properties.resume:
            return "Go on with the job in the output folder from where it stopped"
        if properties.overwrite:
            return "Replace the result or the unfinished job in the output folder"
        return cls.bl_description

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        job = job_of(context.scene)
        if job is not None and not job.ended:
            cls.poll_message_set("A job is running in this output folder")
            return False
        return True

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        output = self._output(context.scene)
        if not (self.capture or context.scene.nep.capture) and not bpy.app.background:
            return set(bpy.ops.nep.choose_folder("INVOKE_DEFAULT"))  # from the search of menus, for example
        if self.overwrite and output is not None and (is_asset(output) or has_checkpoint(output)):
            message = "This replaces the result or the unfinished job in the output folder."
            return self._ask(context, event, title="Start Again", message=message)
        return {"FINISHED"} if self._start(context, wait=False) else {"CANCELLED"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        if self._is_double_click():
            return {"CANCELLED"}
        wait = self.wait and not self.options.is_invoke  # is_invoke: the artist has confirmed the question of `invoke`
        job = self._start(context, wait)
        if job is None:
            return {"CANCELLED"}
        if not wait:
            return {"FINISHED"}
        if job.failed is None:
            import_job_result(job)
        if job.failed is not None:
            self.report({"WARNING" if job.was_stopped else "ERROR"}, str(job.failed))
            return {"CANCELLED"}
        return {"FINISHED"}

    def _output(self, scene: bpy.types.Scene) -> Path | None:
        return resolve_folder(self.output or scene.nep.output)

    def _start(self, context: bpy.types.Context, wait: bool) -> Job | None:
        """Start the job. None where it cannot be started: then a report, or the panel, says why."""
        scene, settings = context.scene, context.scene.nep
        capture, output = resolve_folder(self.capture or settings.capture), self._output(scene)
        if capture is None or output is None:
            both_named = (self.capture or settings.capture) and (self.output or settings.output)
            self.report({"ERROR"}, SAVE_FILE_FIRST if both_named else "Choose a capture folder and an output folder first")
            return None
        if refused := why_not_usable(capture):
            self.report({"ERROR"}, refused)
            return None
        # asked before `is_running`, because a correction holds the lock of a job
        if registry.running(MaterialCorrection, output) is not None:
            self.report({"ERROR"}, f"The materials in {output} are being corrected; wait until that has ended")
            return None
        if is_running(output):
            self.report(
                {"ERROR"}, f"The engine is at work in {output} already; wait for it, or choose another output folder"
            )
            return None
        try:
            arguments = self._engine_arguments(scene, capture, output)
            python = find_engine_python(configured=engine_python(context))
            engine = Engine.start(python, arguments, keep_going=settings.closing == "KEEP")
        except ValueError as error:  # the object bounds cannot be used
            self.report({"ERROR"}, str(error))
            return None
        except EngineError as error:
            registry.keep(Job(output, scene, None, error))  # the panel says why
            self.report({"ERROR"}, str(error))
            return None
        if bounds_warning(scene):
            self.report({"WARNING"}, bounds_warning(scene))
        job = Job(output, scene, engine)
        job.import_when_ended = not wait  # a script imports it itself, also where the scene has another output folder
        return registry.start(job, wait=wait)

    def _engine_arguments(self, scene: bpy.types.Scene, capture: Path, output: Path) -> list[str]:
        """The engine's command line for this scene. ValueError where the object bounds have no size."""
        settings = scene.nep
        return reconstruct_arguments(
            str(capture),
            str(output),
            preset=settings.preset if self.preset == "SCENE" else self.preset,
            device=settings.device,
            seed=settings.seed,
            masks="use" if settings.use_masks else "ignore",
            metal=settings.metal,
            turntable=settings.turntable,
            faces=(settings.faces or None) if not settings.mesh else None,
            mesh=bpy.path.abspath(settings.mesh) if settings.mesh else None,
            threads=settings.threads or None,
            all_photos=settings.all_photos,
            resume=self.resume,
            overwrite=self.overwrite,
            preview=settings.use_preview,
            keep_going=settings.closing == "KEEP",
            more=tuple(bounds_arguments(scene)),
        )


class NEP_OT_cancel(bpy.types.Operator):
    bl_idname = "nep.cancel"
    bl_label = "Cancel"
    bl_description = "Stop the reconstruction; its checkpoint is kept, so that it can be resumed"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        job = job_of(context.scene)
        if job is None or job.ended:
            cls.poll_message_set("No job is running in the output folder")
            return False
        if job.stopping:
            cls.poll_message_set("It is stopping already")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        job_of(context.scene).stop()
        return {"FINISHED"}


class NEP_OT_open_log(bpy.types.Operator):
    bl_idname = "nep.open_log"
    bl_label = "Open Log"
    bl_description = "Read what the job in the output folder has written down, in a text editor"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not any(os.path.isfile(path) for path in _log_files(context.scene)):
            cls.poll_message_set("There is no log in the output folder")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        parts = []
        for path in _log_files(context.scene):
            try:
                parts.append(f"{path}\n\n{path.read_text(encoding='utf-8', errors='replace')[-LOG_LETTERS:]}")
            except OSError:
                continue  # the other log is shown alone
        text = bpy.data.texts.get("NeP log") or bpy.data.texts.new("NeP log")
        text.clear()
        text.write("\n\n".join(parts))
        if not bpy.app.background:
            open_editor(context, "TEXT_EDITOR").text = text
        return {"FINISHED"}


def _log_files(scene: bpy.types.Scene) -> list[Path]:
    """The job's own log, and what the engine and its libraries have printed."""
    output = resolve_folder(scene.nep.output)
    return [] if output is None else [output / "log.txt", output / FOLDER / "engine.log"]


class NEP_OT_dismiss(bpy.types.Operator):
    bl_idname = "nep.dismiss"
    bl_label = "Dismiss"
    bl_description = "Take what has ended out of the status bar"

    def execute(self, context: bpy.types.Context) -> set[str]:
        for task in registry.tasks_of(registry.Task):
            task.is_news = False
        clock.redraw(clock.STATUS_BAR)
        return {"FINISHED"}


CLASSES = (NEP_OT_reconstruct, NEP_OT_cancel, NEP_OT_open_log, NEP_OT_dismiss)
