"""The Blender add-on: the sidebar (3D viewport, tab NeP), its buttons, and the jobs that run beside Blender.

The modules form layers. A module imports only modules of the layers below its own:

    __init__                                                              registers and unregisters everything
    preferences, panels/                                                  what Blender draws
    operators/                                                            what a button or a script calls
    tasks/                                                                jobs and all other work in other processes
    scene/                                                                objects, images and settings in the .blend file
    engine_errors, engine_paths, editors, halved_pictures, wrapped_text   what Blender and the preferences offer
    capture_choice, saved_elsewhere                                       the capture's parts and result; Save As
    capture_folder, folders, properties                                   the settings, `scene.nep`, and their folders
    face_limit, folder_changes, languages                                 changes of settings; translations

`register` puts functions of the upper layers among the callbacks of `folder_changes`.
Panels and `tasks/running_jobs` call operators by their names in Blender (`nep.import_result`), not by an import.
What needs no sidebar is in backend/, below all of these layers: the engine's process, captures, assets, renders.
"""

import atexit

import bpy

from . import (
    capture_choice,
    folder_changes,
    halved_pictures,
    languages,
    operators,
    panels,
    preferences,
    properties,
    saved_elsewhere,
)
from .panels import menus, status_bar, swatches
from .scene import shelf_scene
from .tasks import clock, material_correction, photo_check, registry, running_jobs

CLASSES = (
    preferences.NepPreferences,
    properties.NepMaterial,
    properties.NepShelfFolder,
    properties.NepSettings,
    *operators.CLASSES,
    *panels.CLASSES,
)
HANDLERS = (
    ("load_post", registry.on_file_loaded),
    ("load_post", running_jobs.on_file_loaded),  # after the registry has forgotten what ended in the file before
    ("load_post", material_correction.on_file_loaded),
    ("save_pre", saved_elsewhere.on_save_begins),
    ("save_post", saved_elsewhere.on_save_ended),
    ("save_post_fail", saved_elsewhere.on_save_ended),
    ("save_post", shelf_scene.on_file_saved),
    ("undo_post", running_jobs.on_undone),
    ("redo_post", running_jobs.on_undone),
    ("undo_post", material_correction.on_undone),
    ("redo_post", material_correction.on_undone),
)


def register() -> None:
    """Make the add-on known to Blender, and find the jobs of a file that is open already."""
    languages.register()
    for cls in CLASSES:
        bpy.utils.register_class(cls)
    bpy.types.Scene.nep = bpy.props.PointerProperty(type=properties.NepSettings)
    folder_changes.output_callbacks.append(running_jobs.attach_job)
    folder_changes.capture_callbacks.append(capture_choice.on_capture_chosen)  # first: it may name the whole capture
    folder_changes.capture_callbacks.append(photo_check.on_capture_chosen)
    for event, handler in HANDLERS:
        getattr(bpy.app.handlers, event).append(handler)
    status_bar.add()
    menus.add()
    clock.call_until_false(_attach_jobs_once)  # later: in `register` bpy.data has no scenes
    atexit.register(_close_all)


def unregister() -> None:
    """Undo `register`. Jobs that were started to keep going go on."""
    atexit.unregister(_close_all)
    _close_all()
    running_jobs.remove_old_previews()  # not in `_close_all`: at Blender's very end there are no data-blocks any more
    del bpy.types.Scene.nep
    for cls in reversed(CLASSES):
        bpy.utils.unregister_class(cls)


def _attach_jobs_once() -> bool:
    running_jobs.attach_jobs_of_all_scenes()
    return False


def _close_all() -> None:
    """Stop the timer, the handlers and all work under way. A timer or handler that is left makes Blender hang at its end."""
    languages.unregister()
    status_bar.remove()
    menus.remove()
    folder_changes.output_callbacks.clear()
    folder_changes.capture_callbacks.clear()
    clock.stop()
    for event, handler in HANDLERS:
        if handler in getattr(bpy.app.handlers, event):
            getattr(bpy.app.handlers, event).remove(handler)
    registry.close_all()
    halved_pictures.remove_all_pictures()
    swatches.remove_all_swatches()
