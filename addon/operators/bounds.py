"""The operators of the object's bounds: propose them, remove them."""

import bpy

from ...backend.scene_io.capture_files import read_bounds
from ..engine_errors import error_text
from ..engine_paths import engine_python
from ..scene.object_bounds import bounds_object, place_bounds
from ..tasks import registry
from ..tasks.bounds_estimate import BoundsEstimate
from ..tasks.camera_search import CHOOSE_CAPTURE, usable_capture


class NEP_OT_propose_bounds(bpy.types.Operator):
    bl_idname = "nep.propose_bounds"
    bl_label = "Propose Bounds"
    bl_description = (
        "Put a sphere around the object: the capture's own, or an estimate from its cameras and masks. "
        "Then move and scale it until the whole object is inside, and no camera"
    )
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if registry.running(BoundsEstimate) is not None:
            cls.poll_message_set("The bounds are being estimated")
            return False
        if not context.scene.nep.capture:
            cls.poll_message_set(CHOOSE_CAPTURE)
            return False
        return True

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return self._propose(context, wait=bpy.app.background)

    def execute(self, context: bpy.types.Context) -> set[str]:
        return self._propose(context, wait=True)

    def _propose(self, context: bpy.types.Context, wait: bool) -> set[str]:
        scene = context.scene
        registry.forget_ended(BoundsEstimate)  # the panel no longer shows why the last one failed
        try:
            capture = usable_capture(scene.nep.capture)
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        try:
            known = read_bounds(capture)
        except (OSError, ValueError) as error:
            self.report({"ERROR"}, f"The capture cannot be read: {error}")
            return {"CANCELLED"}
        if known:
            place_bounds(scene, capture, *known)
            self.report({"INFO"}, "Bounds of transforms.json")
            return {"FINISHED"}
        estimate = registry.start(BoundsEstimate(scene, capture, engine_python(context)), wait=wait)
        if not wait:
            return {"FINISHED"}
        if estimate.error is not None:
            self.report({"ERROR"}, error_text(estimate.error))
            return {"CANCELLED"}
        self.report({"INFO"}, "Bounds estimated from the photos")
        return {"FINISHED"}


class NEP_OT_clear_bounds(bpy.types.Operator):
    bl_idname = "nep.clear_bounds"
    bl_label = "Clear Bounds"
    bl_description = "Remove the object bounds: the engine then chooses them itself"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if bounds_object(context.scene) is None:
            cls.poll_message_set("There are no object bounds")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        bpy.data.objects.remove(context.scene.nep.bounds)
        return {"FINISHED"}


CLASSES = (NEP_OT_propose_bounds, NEP_OT_clear_bounds)
