"""The sidebar (3D viewport, tab NeP): settings, the running job, and the panel that shows both."""
import bpy

from . import panel, preferences, reconstruct, settings

CLASSES = (preferences.NepPreferences, settings.NepSettings, reconstruct.NEP_OT_reconstruct, reconstruct.NEP_OT_cancel,
           panel.NEP_PT_reconstruct)


def register():
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    bpy.types.Scene.nep = bpy.props.PointerProperty(type=settings.NepSettings)


def unregister():
    reconstruct.end_job()
    del bpy.types.Scene.nep
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
