"""The operator that corrects the materials of the imported result."""

from pathlib import Path

import bpy
from bpy.app.translations import pgettext_iface

from ...backend.engine.command import EngineError, find_engine_python
from ...backend.engine.exit_codes import OUTPUT_FAILED
from ...backend.engine.results.job_files import has_checkpoint, is_asset, is_running
from ..engine_errors import error_text
from ..engine_paths import engine_python
from ..folders import SAVE_FILE_FIRST, resolve_folder
from ..scene.imported_materials import chosen_corrections, is_list_of
from ..tasks import registry
from ..tasks.material_correction import NOT_IN_FILE, MaterialCorrection, start_correction


class NEP_OT_correct_materials(bpy.types.Operator):
    bl_idname = "nep.correct_materials"
    bl_label = "Apply"
    bl_description = (
        "Make the materials again with your corrections, from the light that is known already. "
        "Replaces the textures in the result's folder and in this file; Reset brings the learned ones back"
    )

    reset: bpy.props.BoolProperty(
        name="Reset", description="Take all corrections back: the materials as they were learned", options={"SKIP_SAVE"}
    )

    @classmethod
    def description(cls, context: bpy.types.Context, properties: bpy.types.OperatorProperties) -> str:
        return "Take all corrections back: the materials as they were learned" if properties.reset else cls.bl_description

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if registry.running(MaterialCorrection) is not None:
            cls.poll_message_set("Materials are being corrected")
            return False
        if not context.scene.nep.materials:
            cls.poll_message_set("Import a result first, one that names its materials")
            return False
        return True

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        return self._correct(context, wait=bpy.app.background)

    def execute(self, context: bpy.types.Context) -> set[str]:
        return self._correct(context, wait=True)

    def _correct(self, context: bpy.types.Context, wait: bool) -> set[str]:
        settings = context.scene.nep
        asset = resolve_folder(settings.asset)
        if asset is None:
            self.report({"ERROR"}, SAVE_FILE_FIRST)
            return {"CANCELLED"}
        try:
            _check(context.scene, asset)
            corrections = {} if self.reset else chosen_corrections(settings)
            python = find_engine_python(configured=engine_python(context))
            correction = start_correction(python, asset, corrections, wait=wait)
        except EngineError as error:
            return self._failed(MaterialCorrection.keep_failed_start(asset, error))
        if not wait:
            return {"FINISHED"}
        if correction.failed is not None:
            return self._failed(correction.failed)
        if not correction.is_seen:
            self.report({"WARNING"}, pgettext_iface(NOT_IN_FILE))
        return {"FINISHED"}

    def _failed(self, error: EngineError) -> set[str]:
        self.report({"ERROR"}, error_text(error))
        return {"CANCELLED"}


def _check(scene: bpy.types.Scene, asset: Path) -> None:
    """EngineError where the materials of this asset cannot be corrected now."""
    if is_running(asset):
        raise EngineError(OUTPUT_FAILED, f"The engine is at work in {asset} already.", "Wait for its end, or cancel it.")
    if not is_asset(asset):
        hint = "Bring the folder back, or import the result from the folder where it is now."
        if has_checkpoint(asset):  # a correction that is killed while it writes its files leaves the result so
            hint = "Its job has not ended: Resume it."
        raise EngineError(OUTPUT_FAILED, f"There is no finished result in {asset}.", hint)
    if not is_list_of(scene.nep, asset):
        hint = "Import it, then correct its materials."
        raise EngineError(OUTPUT_FAILED, f"The folder {asset} holds another result by now.", hint)


CLASSES = (NEP_OT_correct_materials,)
