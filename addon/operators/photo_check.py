"""The operators of the check of the photos: begin it, cancel it, show its picture."""

from functools import partial

import bpy
from bpy.app.translations import pgettext_iface

from ...backend.engine.results.capture_facts import facts_of, warnings_of
from ..editors import fit_image, open_editor
from ..engine_errors import error_text
from ..engine_paths import engine_python
from ..folders import resolve_folder
from ..scene.coverage_image import load_coverage
from ..scene.object_bounds import bounds_arguments
from ..tasks import clock, registry
from ..tasks.camera_search import CHOOSE_CAPTURE, usable_capture
from ..tasks.photo_check import PhotoCheck, last_check


class NEP_OT_check_photos(bpy.types.Operator):
    bl_idname = "nep.check_photos"
    bl_label = "Check Photos"
    bl_description = (
        "Let the engine look at all photos and cameras of the capture: from where photos are missing, and what is wrong. "
        "Takes some seconds; nothing is changed"
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if registry.running(PhotoCheck) is not None:
            cls.poll_message_set("Photos are being checked")
            return False
        if not context.scene.nep.capture:
            cls.poll_message_set(CHOOSE_CAPTURE)
            return False
        return True

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return self._check(context, wait=bpy.app.background)

    def execute(self, context: bpy.types.Context) -> set[str]:
        return self._check(context, wait=True)

    def _check(self, context: bpy.types.Context, wait: bool) -> set[str]:
        try:
            capture = usable_capture(context.scene.nep.capture)
            bounds = tuple(bounds_arguments(context.scene))
        except ValueError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        check = registry.start(PhotoCheck(capture, engine_python(context), bounds), wait=wait)
        if not wait:
            return {"FINISHED"}
        if check.error is not None:
            self.report({"ERROR"}, error_text(check.error))
            return {"CANCELLED"}
        for warning in warnings_of(check.found):
            self.report({"WARNING"}, warning.words(pgettext_iface))
        self.report({"INFO"}, "\n".join(facts_of(check.found, pgettext_iface)))
        return {"FINISHED"}


class NEP_OT_cancel_check_photos(bpy.types.Operator):
    bl_idname = "nep.cancel_check_photos"
    bl_label = "Cancel"
    bl_description = "Stop looking at the photos"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if registry.running(PhotoCheck) is None:
            cls.poll_message_set("No photos are being checked")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        registry.forget(registry.running(PhotoCheck))
        clock.redraw("VIEW_3D")
        return {"FINISHED"}


class NEP_OT_show_coverage(bpy.types.Operator):
    bl_idname = "nep.show_coverage"
    bl_label = "Show Large"
    bl_description = "Show the picture with the names of photos in an Image Editor: one that is open, or a window of its own"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        check = last_check(resolve_folder(context.scene.nep.capture))
        if check is None or check.picture is None:
            cls.poll_message_set("Check the photos first")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        image = load_coverage(last_check(resolve_folder(context.scene.nep.capture)).picture)
        if not bpy.app.background:
            open_editor(context, "IMAGE_EDITOR").image = image
            clock.call_until_false(partial(fit_image, image.name))  # one period later: a new window has no size yet
        return {"FINISHED"}


CLASSES = (NEP_OT_check_photos, NEP_OT_cancel_check_photos, NEP_OT_show_coverage)
