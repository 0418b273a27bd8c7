"""The sidebar (3D viewport, tab NeP): settings, the running job, and the panel that shows both."""
import bpy

from . import background, bounds, cameras, comparison, panel, preferences, reconstruct, result, settings, subpanels

CLASSES = (preferences.NepPreferences, settings.NepSettings, reconstruct.NEP_OT_reconstruct, reconstruct.NEP_OT_cancel,
           panel.NEP_PT_reconstruct, *cameras.CLASSES, *bounds.CLASSES, *result.CLASSES, *comparison.CLASSES,
           *subpanels.CLASSES)


def register():
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    bpy.types.Scene.nep = bpy.props.PointerProperty(type=settings.NepSettings)
    background.register()


def unregister():
    reconstruct.end_job()
    background.unregister()
    bounds.end_query()
    comparison.end_render()
    del bpy.types.Scene.nep
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)
