"""The operators: reconstruct a glossy object with the engine in its own process, and cancel that.

In the interface the job runs beside Blender (a modal operator with a timer looks after it); called from a script
(`bpy.ops.nep.reconstruct(...)`) the operator returns when the object is there.
"""
import time
from pathlib import Path

import bpy

from ..backend.engine import Engine, EngineError, describe, find_engine_python, reconstruct_arguments
from .bounds import bounds_arguments, bounds_remark
from .preferences import engine_python
from .result import place_result
from .settings import PRESETS

POLL_S = 0.1


class Job:
    """The engine at work for one output folder, and the last thing it said."""

    def __init__(self, python: str, arguments: list[str], output: Path):
        self.engine = Engine(python, arguments)
        self.output = output
        self.fraction = 0.0
        self.status = "Starting the engine"
        self.stopping = False

    def advance(self) -> bool:
        """Take in the engine's events; True when it has ended."""
        events, ended = self.engine.poll()
        for event in events:
            if event["event"] == "progress":
                self.fraction = min(max(float(event.get("fraction") or 0), 0.0), 1.0)
            if event["event"] in ("progress", "warning") and not self.stopping:
                self.status = describe(event)
        return ended

    def stop(self) -> None:
        self.stopping = True
        self.status = "Stopping: writing the checkpoint"
        self.engine.request_stop()


job: Job | None = None
last_message = ""  # how the last job ended, shown in the panel


def end_job() -> None:
    """Let go of the running job, if any: its engine writes a checkpoint and leaves."""
    global job
    if job is not None:
        job.engine.request_stop()
        job.engine.close()
        job = None


class NEP_OT_reconstruct(bpy.types.Operator):
    bl_idname = "nep.reconstruct"
    bl_label = "Reconstruct Glossy Object"
    bl_description = "Make a mesh with materials, and the light around it, from the photos of the capture folder"

    capture: bpy.props.StringProperty(name="Capture", description="Capture folder; empty: the scene's setting")
    output: bpy.props.StringProperty(name="Output", description="Asset folder; empty: the scene's setting")
    preset: bpy.props.EnumProperty(name="Preset", description="How much time to spend", default="SCENE",
                                   items=(("SCENE", "As in the scene", "The scene's setting"), *PRESETS))

    @classmethod
    def poll(cls, context):
        if job is not None:
            cls.poll_message_set("A reconstruction is running")
            return False
        return True

    def invoke(self, context, event):
        if not self._start(context):
            return {"CANCELLED"}
        self._timer = context.window_manager.event_timer_add(POLL_S, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        for area in context.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()
        if job is not None and not job.advance():
            return {"PASS_THROUGH"}
        context.window_manager.event_timer_remove(self._timer)
        return self._finish(context)

    def cancel(self, context):
        """Blender ends or opens another file."""
        end_job()

    def execute(self, context):
        if not self._start(context):
            return {"CANCELLED"}
        while not job.advance():
            time.sleep(POLL_S)
        return self._finish(context)

    def _start(self, context) -> bool:
        global job, last_message
        settings = context.scene.nep
        capture, output = self.capture or settings.capture, self.output or settings.output
        if not capture or not output:
            self.report({"ERROR"}, "Choose a capture folder and an output folder first")
            return False
        output = Path(bpy.path.abspath(output))
        arguments = reconstruct_arguments(
            bpy.path.abspath(capture), output, preset=settings.preset if self.preset == "SCENE" else self.preset,
            masks="use" if settings.use_masks else "ignore", resume=settings.resume)
        try:
            arguments += bounds_arguments(context.scene)
            if bounds_remark(context.scene):
                self.report({"WARNING"}, bounds_remark(context.scene))
            job = Job(find_engine_python(configured=engine_python(context)), arguments, output)
        except (EngineError, ValueError) as error:
            last_message = str(error)
            self.report({"ERROR"}, last_message)
            return False
        last_message = ""
        return True

    def _finish(self, context):
        global job, last_message
        if job is None:  # let go of meanwhile
            return {"CANCELLED"}
        done, job = job, None
        done.engine.close()
        failed = done.engine.outcome()
        try:
            if failed:
                raise failed
            item = place_result(context.scene, done.output)
        except (EngineError, OSError) as error:
            last_message = str(error)
            self.report({"WARNING" if failed and done.stopping else "ERROR"}, last_message)
            return {"CANCELLED"}
        if not bpy.app.background:
            bpy.ops.ed.undo_push(message=self.bl_label)
        last_message = f"Imported {item.name}; its light is the World '{item.name} light'"
        self.report({"INFO"}, last_message)
        return {"FINISHED"}


class NEP_OT_cancel(bpy.types.Operator):
    bl_idname = "nep.cancel"
    bl_label = "Cancel"
    bl_description = "Stop the reconstruction; its checkpoint is kept, so that it can be resumed"

    @classmethod
    def poll(cls, context):
        if job is None or job.stopping:
            cls.poll_message_set("Nothing to cancel" if job is None else "Already stopping")
            return False
        return True

    def execute(self, context):
        job.stop()
        return {"FINISHED"}
