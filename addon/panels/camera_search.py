"""The box below the capture folder, where its photos have no cameras yet, or where their cameras have just been found."""

import os

import bpy
from bpy.app.translations import pgettext_iface

from ...backend.engine.results.capture_contents import LEAST_PHOTOS
from ..capture_folder import CaptureFolder, last_look_into
from ..folders import resolve_folder
from ..tasks import registry
from ..tasks.camera_search import CameraSearch
from ..wrapped_text import draw_setting, draw_steady, draw_wrapped, fitting
from .failure import draw_failure
from .video import draw_choose_video, draw_videos

PHOTOS, CAMERAS, MASKS, NO_CAMERAS_YET = "{count} photos", "cameras", "masks", "no cameras yet"
TOO_FEW = "Too few photos: {count} of at least {least}"
FOUND = "What the Search Has Found"
NO_PHOTOS = "This folder holds no photos"
LOAD_AGAIN = "Press Load Cameras again to see them."
REPLACED = "They replace the earlier cameras: press Load Cameras and Propose Bounds again."
STOPPING = "Stopping"
IMPROVED = "cameras.improved"  # the engine's message that other cameras were written


def draw_camera_search(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw what the folder holds, and the box. There is no box for a capture with cameras that were not found just now."""
    folder = resolve_folder(context.scene.nep.capture)
    if folder is None:
        draw_choose_video(layout)
        return
    running = registry.running(CameraSearch, folder)
    if running is not None:
        _draw_progress(layout.box(), context, running)
        return
    holds, search = last_look_into(folder), registry.ended(CameraSearch, folder)
    if holds.has_cameras:
        draw_wrapped(layout, context, contents_line(holds), "CHECKMARK")
    only_video = bool(holds.videos) and not holds.has_enough_photos and not holds.has_cameras
    if holds.lacks_cameras and not only_video:
        box = layout.box()
        _draw_offer(box, context, holds)
        if search is not None and search.failed is not None:
            draw_failure(box, context, search.failed)
    elif search is not None and search.failed is not None:
        draw_failure(layout.box(), context, search.failed)
    elif search is not None:
        header, body = layout.panel("nep_cameras_found")  # an artist who has read the long text can fold it
        header.label(text=FOUND)
        if body is not None:
            _draw_found(body.box(), context, search)
    elif not holds.photos and not holds.videos and not holds.has_cameras and os.path.isdir(folder):
        draw_wrapped(layout, context, NO_PHOTOS, "INFO")
    if only_video or (not holds.photos and not holds.has_cameras):
        draw_videos(layout, holds.videos)


def _draw_offer(box: bpy.types.UILayout, context: bpy.types.Context, holds: CaptureFolder) -> None:
    if not holds.has_enough_photos:
        text = pgettext_iface(TOO_FEW).format(count=holds.photos, least=LEAST_PHOTOS)
        draw_wrapped(box, context, text, "CAMERA_DATA")
    else:
        draw_wrapped(box, context, contents_line(holds), "CAMERA_DATA")
        _draw_features(box, context, holds)
        box.operator("nep.find_cameras", icon="VIEWZOOM")


def contents_line(holds: CaptureFolder) -> str:
    """What the folder holds, such as "40 photos, cameras, masks"; an empty string for a folder without any of it."""
    found = [pgettext_iface(PHOTOS).format(count=holds.photos)] if holds.photos else []
    found += [pgettext_iface(CAMERAS)] if holds.has_cameras else []
    found += [pgettext_iface(MASKS)] if found and holds.has_masks else []
    found += [pgettext_iface(NO_CAMERAS_YET)] if holds.lacks_cameras else []
    line = ", ".join(found)
    return line[:1].upper() + line[1:]


def _draw_features(layout: bpy.types.UILayout, context: bpy.types.Context, holds: CaptureFolder) -> None:
    """The choice where to look for details, for a folder with masks."""
    if holds.has_masks:
        draw_setting(layout, context, context.scene.nep, "features")


def _draw_progress(box: bpy.types.UILayout, context: bpy.types.Context, search: CameraSearch) -> None:
    """The bar, with Cancel beside it: a second click on Find Cameras, which stood below, must not cancel."""
    process, progress = search.process, search.process.progress
    row = box.split(factor=0.66, align=True)
    row.progress(factor=progress.fraction, text=f"{100 * progress.fraction:.0f} %")
    row.operator("nep.cancel_find_cameras")
    draw_steady(box, context, [pgettext_iface(STOPPING)] if process.stopping else progress.lines(pgettext_iface))


def _draw_found(box: bpy.types.UILayout, context: bpy.types.Context, search: CameraSearch) -> None:
    texts = [said.words(pgettext_iface) for said in search.process.found]
    if search.improves:
        if any(said.code == IMPROVED for said in search.process.found):
            texts.append(pgettext_iface(LOAD_AGAIN))
    elif search.replaces:
        texts.append(pgettext_iface(REPLACED))
    draw_wrapped(box, context, "\n".join(texts), "CHECKMARK")
    for warning in search.process.warnings:
        draw_wrapped(box, context, warning.words(pgettext_iface), "INFO")


def draw_find_again(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """The buttons that replace and that improve the cameras which a folder has. Nothing is drawn for other folders."""
    folder = resolve_folder(context.scene.nep.capture)
    holds = CaptureFolder() if folder is None else last_look_into(folder)
    if not holds.has_cameras:
        return
    _draw_features(layout, context, holds)
    if holds.has_transforms and holds.has_enough_photos:
        text = fitting(context, "Find Cameras Again", "Find Again")
        layout.operator("nep.find_cameras", text=text, icon="FILE_REFRESH").overwrite = True
    layout.operator("nep.improve_cameras", icon="MODIFIER")
