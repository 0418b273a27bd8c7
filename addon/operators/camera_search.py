"""The operators of the search for the cameras of photos: begin it, improve cameras, cancel it."""

from pathlib import Path

import bpy
from bpy.app.translations import pgettext_iface

from ...backend.engine.command import EngineError, find_engine_python
from ...backend.engine.commands.camera_process import check_writable
from ..capture_folder import last_look_into, look_into
from ..engine_errors import error_text
from ..engine_paths import engine_python
from ..folders import SAVE_FILE_FIRST, resolve_folder
from ..tasks import registry
from ..tasks.camera_search import CameraSearch, start_search
from ..tasks.running_jobs import job_of
from .confirmation import Asks


class CameraOperator(Asks):
    """What the operators that find and that improve cameras share."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if registry.running(CameraSearch) is not None:
            cls.poll_message_set("Cameras are being found")
            return False
        if not context.scene.nep.capture:
            cls.poll_message_set("Choose a folder with photos first")
            return False
        return cls._no_job_runs(context)

    @classmethod
    def _no_job_runs(cls, context: bpy.types.Context) -> bool:
        job = job_of(context.scene)
        if job is not None and not job.ended:  # it could not be resumed with other cameras
            cls.poll_message_set("A job is running in the output folder")
            return False
        return True

    def _find(
        self,
        context: bpy.types.Context,
        *,
        wait: bool,
        replace: bool,
        improve: bool = False,
        video: Path | None = None,
        frames: int | None = None,
    ) -> set[str]:
        """Start the search. `video`: of its frames, at most `frames`, which are put into the capture folder."""
        settings = context.scene.nep
        folder = resolve_folder(settings.capture)
        if folder is None:
            self.report({"ERROR"}, SAVE_FILE_FIRST)
            return {"CANCELLED"}
        try:
            check_writable(folder if video is None else video.parent)
            python = find_engine_python(configured=engine_python(context))
            holds = look_into(folder)
            # what is found there now are no masks of frames that are yet to be taken
            of_video = video is not None or (holds.videos > 0 and not holds.has_enough_photos)
            search = start_search(
                python,
                folder,
                threads=settings.threads or None,
                features=settings.features if holds.has_masks and not of_video else "everywhere",
                replace=replace,
                improve=improve,
                video=video,
                frames=frames,
                wait=wait,
            )
        except EngineError as error:
            return self._failed(CameraSearch.keep_failed_start(folder, error))
        if not wait:
            return {"FINISHED"}
        if search.failed is not None:
            return self._failed(search.failed)
        for warning in search.process.warnings:
            self.report({"WARNING"}, warning.words(pgettext_iface))
        self.report({"INFO"}, "\n".join(said.words(pgettext_iface) for said in search.process.found))
        return {"FINISHED"}

    def _failed(self, error: EngineError) -> set[str]:
        self.report({"ERROR"}, error_text(error))
        return {"CANCELLED"}


class NEP_OT_find_cameras(CameraOperator, bpy.types.Operator):
    bl_idname = "nep.find_cameras"
    bl_label = "Find Cameras"
    bl_description = (
        "Find where the photos of the capture folder were taken, and write that into the folder. "
        "The photos must overlap and show the same things around the object"
    )

    overwrite: bpy.props.BoolProperty(
        name="Overwrite", description="Replace the cameras that the folder has", options={"SKIP_SAVE"}
    )

    @classmethod
    def description(cls, context: bpy.types.Context, properties: bpy.types.OperatorProperties) -> str:
        if properties.overwrite:
            return "Find the cameras of the photos anew, and replace those that the capture folder has"
        return cls.bl_description

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        folder = resolve_folder(context.scene.nep.capture)
        if self.overwrite and folder is not None and look_into(folder).has_cameras:
            message = "This replaces the cameras in the capture folder. A copy of the present ones is kept there."
            return self._ask(context, event, title="Find Cameras Again", message=message)
        return self._find(context, wait=bpy.app.background, replace=self.overwrite)

    def execute(self, context: bpy.types.Context) -> set[str]:
        if self._is_double_click():
            return {"CANCELLED"}
        wait = not self.options.is_invoke  # is_invoke: the artist has confirmed the question
        return self._find(context, wait=wait, replace=self.overwrite)


class NEP_OT_improve_cameras(CameraOperator, bpy.types.Operator):
    bl_idname = "nep.improve_cameras"
    bl_label = "Improve Cameras"
    bl_description = (
        "Let the photos correct the cameras that the capture has, in the same frame and scale. "
        "Cameras that cannot be improved stay as they are"
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not super().poll(context):
            return False
        folder = resolve_folder(context.scene.nep.capture)
        if folder is None or not last_look_into(folder).has_cameras:
            cls.poll_message_set("The capture has no cameras yet")
            return False
        return True

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        message = "Better cameras replace those of the capture. A copy of the present ones is kept in its folder."
        return self._ask(context, event, title="Improve Cameras", message=message)

    def execute(self, context: bpy.types.Context) -> set[str]:
        if self._is_double_click():
            return {"CANCELLED"}
        return self._find(context, wait=not self.options.is_invoke, replace=True, improve=True)


class NEP_OT_cancel_find_cameras(bpy.types.Operator):
    bl_idname = "nep.cancel_find_cameras"
    bl_label = "Cancel"
    bl_description = "Stop looking for the cameras; nothing is written"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        search = registry.running(CameraSearch)
        if search is None:
            cls.poll_message_set("No cameras are being found")
            return False
        if search.process.stopping:
            cls.poll_message_set("It is stopping already")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        registry.running(CameraSearch).process.stop()
        return {"FINISHED"}


CLASSES = (NEP_OT_find_cameras, NEP_OT_improve_cameras, NEP_OT_cancel_find_cameras)
