"""The operators of the preferences: check the engine, install it, cancel the installation, open the preferences."""

import bpy

from ...backend.engine.command import EngineError, find_engine_python
from .. import engine_paths
from ..tasks import engine_setup, registry
from ..tasks.camera_search import CameraSearch
from ..tasks.engine_setup import Installation, PythonCheck
from ..tasks.material_correction import MaterialCorrection
from ..tasks.running_jobs import Job
from ..tasks.shelf_batch import ShelfBatch


def engine_at_work() -> bool:
    """Whether a job, a batch, a search for cameras or a correction uses the engine, so that it must stay where it is."""
    return any(registry.running(kind) is not None for kind in (Job, ShelfBatch, CameraSearch, MaterialCorrection))


class NEP_OT_check_engine(bpy.types.Operator):
    bl_idname = "nep.check_engine"
    bl_label = "Check"
    bl_description = "Say which Python runs the engine, and what it has or lacks"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if registry.running(PythonCheck) is not None:
            cls.poll_message_set("The Python is being asked")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        try:
            engine_setup.start_check(find_engine_python(configured=engine_paths.engine_python(context)))
        except EngineError as error:
            self.report({"WARNING"}, str(error))
            registry.forget_ended(PythonCheck)  # there is no Python to ask
            return {"CANCELLED"}
        return {"FINISHED"}


class NEP_OT_install_engine(bpy.types.Operator):
    bl_idname = "nep.install_engine"
    bl_label = "Install Engine"
    bl_description = "Download what the engine needs (torch and others) into an environment of its own"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if registry.running(Installation) is not None:
            cls.poll_message_set("It is being installed")
            return False
        if engine_at_work():
            cls.poll_message_set("The engine is at work: wait for its end, or cancel it")
            return False
        if not bpy.app.online_access:
            cls.poll_message_set(engine_setup.ALLOW_ONLINE_ACCESS)
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        folder = engine_paths.engine_folder(context)
        if folder is None:
            self.report({"ERROR"}, "Choose a folder to install into")
            return {"CANCELLED"}
        try:
            engine_setup.start_installation(folder, engine_paths.base_python(context), engine_paths.torch_build(context))
        except OSError as error:
            self.report({"ERROR"}, f"The installation cannot be started: {error}")
            return {"CANCELLED"}
        return {"FINISHED"}


class NEP_OT_cancel_install(bpy.types.Operator):
    bl_idname = "nep.cancel_install"
    bl_label = "Cancel"
    bl_description = "Stop the installation and remove what it has made"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        installation = registry.running(Installation)
        if installation is None:
            cls.poll_message_set("Nothing is being installed")
            return False
        if installation.cancelling:
            cls.poll_message_set("It is being cancelled")
            return False
        return True

    def execute(self, context: bpy.types.Context) -> set[str]:
        registry.running(Installation).cancel()
        return {"FINISHED"}


class NEP_OT_open_preferences(bpy.types.Operator):
    bl_idname = "nep.open_preferences"
    bl_label = "Engine Preferences"
    bl_description = "Open the preferences where the engine is installed or chosen"

    def execute(self, context: bpy.types.Context) -> set[str]:
        bpy.ops.preferences.addon_show(module=engine_paths.EXTENSION_PACKAGE)
        return {"FINISHED"}


CLASSES = (NEP_OT_check_engine, NEP_OT_install_engine, NEP_OT_cancel_install, NEP_OT_open_preferences)
