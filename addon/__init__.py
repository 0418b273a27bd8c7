"""The sidebar (3D viewport, tab NeP): settings, the running job, and the panel that shows both."""

import atexit

import bpy

from . import (
    bounds,
    cameras,
    clock,
    comparison,
    comparison_picture,
    engine_setup,
    jobs,
    live_preview,
    panel,
    preferences,
    reconstruct,
    result,
    settings,
    subpanels,
)

CLASSES = (
    preferences.NepPreferences,
    settings.NepSettings,
    *reconstruct.CLASSES,
    *engine_setup.CLASSES,
    *cameras.CLASSES,
    *bounds.CLASSES,
    *result.CLASSES,
    *comparison.CLASSES,
    *comparison_picture.CLASSES,
    panel.NEP_PT_reconstruct,
    *subpanels.CLASSES,
)


def register():
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    bpy.types.Scene.nep = bpy.props.PointerProperty(type=settings.NepSettings)
    bpy.app.handlers.load_post.append(jobs.on_load)
    clock.watch(_look_once)  # a file may be open already; its scenes are out of reach while the add-on registers
    atexit.register(_let_go)


def unregister():
    atexit.unregister(_let_go)
    _let_go()
    del bpy.types.Scene.nep
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)


def _look_once() -> bool:
    jobs.look_everywhere()
    return False


def _let_go() -> None:
    """A timer or handler that is left when Blender ends makes it hang or crash."""
    clock.stop()
    if jobs.on_load in bpy.app.handlers.load_post:
        bpy.app.handlers.load_post.remove(jobs.on_load)
    jobs.let_go()
    engine_setup.let_go()
    bounds.end_query()
    comparison.end_render()
    live_preview.close()
