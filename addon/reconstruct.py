"""The operators of a job: start (or resume) it, cancel it, read its log.

In the interface the job runs beside Blender and jobs.py looks after it; called from a script
(`bpy.ops.nep.reconstruct(...)`) the operator returns when the object is there.
"""

import time
from pathlib import Path

import bpy

from ..backend.engine.command import EngineError, find_engine_python, reconstruct_arguments
from ..backend.engine.engine import Engine
from ..backend.engine.job_files import FOLDER, has_checkpoint, is_asset, is_running
from . import bounds, clock, jobs, preferences, settings
from .editors import open_editor

LOG_LETTERS = 200_000


class NEP_OT_reconstruct(bpy.types.Operator):
    bl_idname = "nep.reconstruct"
    bl_label = "Reconstruct Glossy Object"
    bl_description = "Make a mesh with materials, and the light around it, from the photos of the capture folder"

    capture: bpy.props.StringProperty(name="Capture", description="Capture folder; empty: the scene's setting")
    output: bpy.props.StringProperty(name="Output", description="Result folder; empty: the scene's setting")
    preset: bpy.props.EnumProperty(
        name="Preset",
        description="How much time to spend",
        default="SCENE",
        items=(("SCENE", "As in the scene", "The scene's setting"), *settings.PRESETS),
    )
    resume: bpy.props.BoolProperty(name="Resume", description="Go on from the checkpoint in the output folder")
    overwrite: bpy.props.BoolProperty(name="Overwrite", description="Replace what is in the output folder")
    wait: bpy.props.BoolProperty(name="Wait", description="In a script: return when the object is there", default=True)

    @classmethod
    def description(cls, context, properties):
        if properties.resume:
            return "Go on with the job in the output folder from where it stopped"
        if properties.overwrite:
            return "Replace the result or the unfinished job in the output folder"
        return cls.bl_description

    @classmethod
    def poll(cls, context):
        job = jobs.of(context.scene)
        if job is not None and not job.ended:
            cls.poll_message_set("A job is running in this output folder")
            return False
        return True

    def invoke(self, context, event):
        output = self._output(context)
        if self.overwrite and output is not None and (is_asset(output) or has_checkpoint(output)):
            return context.window_manager.invoke_confirm(
                self,
                event,
                title="Start Again",
                confirm_text="Start Again",
                message="This replaces the result or the unfinished job in the output folder.",
            )
        return {"FINISHED"} if self._start(context) else {"CANCELLED"}

    def execute(self, context):
        job = self._start(context)
        if job is None:
            return {"CANCELLED"}
        if self.options.is_invoke or not self.wait:  # confirmed in the interface
            return {"FINISHED"}
        job.watched = False  # it is imported here, whatever scene has its folder
        while not job.ended:
            job.advance()
            time.sleep(clock.PERIOD_S)
        jobs.clean_up(job)
        if job.failed is None:
            jobs.import_result(job)
        if job.failed is not None:
            self.report({"WARNING" if job.was_stopped else "ERROR"}, str(job.failed))
            return {"CANCELLED"}
        return {"FINISHED"}

    def _output(self, context) -> Path | None:
        return settings.folder(self.output or context.scene.nep.output)

    def _start(self, context) -> jobs.Job | None:
        """A job that has begun, or None when it cannot: the report and the panel say why."""
        chosen = context.scene.nep
        capture, output = settings.folder(self.capture or chosen.capture), self._output(context)
        if capture is None or output is None:
            named = (self.capture or chosen.capture) and (self.output or chosen.output)
            self.report({"ERROR"}, settings.NOT_SAVED if named else "Choose a capture folder and an output folder first")
            return None
        if is_running(output):
            self.report({"ERROR"}, f"Another job is running in {output}; wait for it, or choose another output folder")
            return None
        keep_going = chosen.closing == "KEEP"
        try:
            sphere = bounds.bounds_arguments(context.scene)
            python = find_engine_python(configured=preferences.engine_python(context))
            engine = Engine.start(
                python,
                reconstruct_arguments(
                    str(capture),
                    str(output),
                    preset=chosen.preset if self.preset == "SCENE" else self.preset,
                    device=chosen.device,
                    seed=chosen.seed,
                    masks="use" if chosen.use_masks else "ignore",
                    metal=chosen.metal,
                    mesh=bpy.path.abspath(chosen.mesh) if chosen.mesh else None,
                    threads=chosen.threads or None,
                    resume=self.resume,
                    overwrite=self.overwrite,
                    preview=chosen.use_preview,
                    keep_going=keep_going,
                    more=tuple(sphere),
                ),
                keep_going=keep_going,
            )
        except ValueError as error:  # of the bounds
            self.report({"ERROR"}, str(error))
            return None
        except EngineError as error:
            jobs.jobs[jobs.key(output)] = jobs.Job(output, None, failed=error)
            self.report({"ERROR"}, str(error))
            return None
        if bounds.bounds_remark(context.scene):
            self.report({"WARNING"}, bounds.bounds_remark(context.scene))
        job = jobs.Job(output, engine)
        jobs.add(job)
        return job


class NEP_OT_cancel(bpy.types.Operator):
    bl_idname = "nep.cancel"
    bl_label = "Cancel"
    bl_description = "Stop the reconstruction; its checkpoint is kept, so that it can be resumed"

    @classmethod
    def poll(cls, context):
        job = jobs.of(context.scene)
        if job is None or job.ended or job.stopping:
            cls.poll_message_set(
                "It is stopping already"
                if job and job.stopping and not job.ended
                else "No job is running in the output folder"
            )
            return False
        return True

    def execute(self, context):
        jobs.of(context.scene).stop()
        return {"FINISHED"}


class NEP_OT_open_log(bpy.types.Operator):
    bl_idname = "nep.open_log"
    bl_label = "Open Log"
    bl_description = "Read what the job in the output folder has written down, in a text editor"

    @classmethod
    def poll(cls, context):
        if not any(path.is_file() for path in _logs(context.scene)):
            cls.poll_message_set("There is no log in the output folder")
            return False
        return True

    def execute(self, context):
        parts = []
        for path in _logs(context.scene):
            try:
                parts.append(f"{path}\n\n{path.read_text(encoding='utf-8', errors='replace')[-LOG_LETTERS:]}")
            except OSError:
                continue  # one of the two is enough
        text = bpy.data.texts.get("NeP log") or bpy.data.texts.new("NeP log")
        text.clear()
        text.write("\n\n".join(parts))
        if not bpy.app.background:
            open_editor(context, "TEXT_EDITOR").text = text
        return {"FINISHED"}


def _logs(scene) -> list[Path]:
    output = settings.folder(scene.nep.output)
    return [] if output is None else [output / "log.txt", output / FOLDER / "engine.log"]


CLASSES = (NEP_OT_reconstruct, NEP_OT_cancel, NEP_OT_open_log)
