"""The operator that takes a video in the place of photos: its frames and their cameras become a capture."""

from pathlib import Path

import bpy

from ...backend.engine.results.capture_contents import VIDEO_ENDINGS
from ..tasks import registry
from ..tasks.camera_search import CameraSearch
from .camera_search import CameraOperator

FRAMES, MOST_FRAMES = 80, 250  # as the engine's option --frames


class NEP_OT_find_cameras_of_video(CameraOperator, bpy.types.Operator):
    bl_idname = "nep.find_cameras_of_video"
    bl_label = "From a Video"
    bl_description = (
        "Choose a video of a walk around the object. Its sharpest frames become photos, in a folder beside the video, and "
        "their cameras are found. That folder becomes the capture folder"
    )
    bl_options = {"UNDO"}  # otherwise the next undo takes the choice back, too

    filepath: bpy.props.StringProperty(subtype="FILE_PATH", options={"SKIP_SAVE", "HIDDEN"})
    filter_movie: bpy.props.BoolProperty(default=True, options={"SKIP_SAVE", "HIDDEN"})
    filter_folder: bpy.props.BoolProperty(default=True, options={"SKIP_SAVE", "HIDDEN"})
    frames: bpy.props.IntProperty(
        name="Frames", description="So many frames become photos at most", default=FRAMES, min=20, max=MOST_FRAMES
    )
    overwrite: bpy.props.BoolProperty(
        name="Overwrite",
        description="Take frames again, and replace the cameras of those that were taken. The present frames, and a copy of "
        "their cameras, stay in the folder",
        options={"SKIP_SAVE"},
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if registry.running(CameraSearch) is not None:
            cls.poll_message_set("Cameras are being found")
            return False
        return cls._no_job_runs(context)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        video = Path(bpy.path.abspath(self.filepath))
        if not self.filepath or not video.is_file() or video.suffix.lower() not in VIDEO_ENDINGS:
            self.report({"ERROR"}, "Choose a video")
            return {"CANCELLED"}
        context.scene.nep.capture = str(video.with_suffix(""))
        return self._find(context, wait=not self.options.is_invoke, replace=self.overwrite, video=video, frames=self.frames)


CLASSES = (NEP_OT_find_cameras_of_video,)
