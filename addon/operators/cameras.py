"""The operators of the cameras: load the capture's, remove them, make a capture of the scene's cameras."""

from pathlib import Path

import bpy

from ...backend.scene_io.capture_files import read_frames
from ...backend.scene_io.photo_cameras import has_loaded_cameras, load_cameras, remove_cameras
from ...backend.scene_io.scene_capture import MINIMUM_PHOTOS, photo_cameras, write_scene_capture
from ..tasks.camera_search import usable_capture


class NEP_OT_load_cameras(bpy.types.Operator):
    bl_idname = "nep.load_cameras"
    bl_label = "Load Cameras"
    bl_description = (
        "Show the capture's cameras in the scene, each with its photo as background image. "
        "Replaces cameras that were loaded before"
    )
    bl_options = {"REGISTER", "UNDO"}

    capture: bpy.props.StringProperty(
        name="Capture", description="Capture folder; empty: the scene's setting", options={"SKIP_SAVE"}
    )
    match_render: bpy.props.BoolProperty(
        name="Match Render Size",
        default=True,
        description="Give the scene the photos' render size and pixel aspect, so that photo and 3D view line up. "
        "Clear Cameras gives the scene's own ones back",
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if context.mode != "OBJECT":
            cls.poll_message_set("Leave Edit Mode first")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            folder = usable_capture(self.capture or context.scene.nep.capture)
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        try:
            frames = read_frames(folder)
        except (OSError, ValueError) as error:
            self.report({"ERROR"}, f"The capture cannot be read: {error}")
            return {"CANCELLED"}
        cameras, missing, not_shown = load_cameras(context.scene, folder, frames, match_render=self.match_render)
        if missing:
            self.report({"WARNING"}, f"{len(missing)} of {len(cameras)} photos are missing, the first: {missing[0]}")
        elif not_shown:
            self.report(
                {"WARNING"},
                f"{len(cameras)} cameras; Blender cannot show {len(not_shown)} of their photos (raw or HEIC), "
                "but the engine uses them",
            )
        elif self.match_render and len({(frame.width, frame.height) for frame in frames}) > 1:
            self.report(
                {"WARNING"}, f"{len(cameras)} cameras; their photos have several sizes, the render size is that of the first"
            )
        else:
            self.report({"INFO"}, f"{len(cameras)} cameras")
        return {"FINISHED"}


class NEP_OT_clear_cameras(bpy.types.Operator):
    bl_idname = "nep.clear_cameras"
    bl_label = "Clear Cameras"
    bl_description = (
        "Remove the cameras that Load Cameras made, and their photos, from the scene. "
        "The scene gets back its own camera and render size"
    )
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if context.mode != "OBJECT" or not has_loaded_cameras(context.scene):
            cls.poll_message_set("Leave Edit Mode first" if context.mode != "OBJECT" else "No cameras are loaded")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        self.report({"INFO"}, f"{remove_cameras(context.scene)} cameras removed")
        return {"FINISHED"}


class NEP_OT_capture_from_scene(bpy.types.Operator):
    bl_idname = "nep.capture_from_scene"
    bl_label = "Capture from This Scene"
    bl_description = (
        "Make a capture folder of the scene's cameras that have a photo as background image, and use it. "
        "The photos stay where they are"
    )
    bl_options = {"UNDO"}

    directory: bpy.props.StringProperty(
        name="Folder",
        description="Folder to write; empty: beside the saved .blend file",
        subtype="DIR_PATH",
        options={"SKIP_SAVE"},
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        found = len(photo_cameras(context.scene))
        if found < MINIMUM_PHOTOS:
            cls.poll_message_set(
                f"{found} cameras of the scene have a photo as background image; {MINIMUM_PHOTOS} or more are needed"
            )
            return False
        return True

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if self.directory or bpy.data.is_saved:
            return self.execute(context)
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        if not self.directory and not bpy.data.is_saved:
            self.report({"ERROR"}, "Save the .blend file first, or choose a folder")
            return {"CANCELLED"}
        folder = self.directory or f"//{Path(bpy.data.filepath).stem}_capture"
        context.view_layer.update()
        try:
            count = write_scene_capture(context.scene, Path(bpy.path.abspath(folder)))
        except (OSError, ValueError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        context.scene.nep.capture = folder
        self.report({"INFO"}, f"A capture of {count} photos; it is chosen now")
        return {"FINISHED"}


CLASSES = (NEP_OT_load_cameras, NEP_OT_clear_cameras, NEP_OT_capture_from_scene)
