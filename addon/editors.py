"""Editors beside the 3D viewport. They show what is too large for the sidebar."""

import bpy


def open_editor(context: bpy.types.Context, kind: str) -> bpy.types.Space:
    """The active space of an editor of this kind ("TEXT_EDITOR" or "IMAGE_EDITOR").

    An editor that is open is taken; without one, a new window with such an editor is opened.
    """
    areas = [area for window in context.window_manager.windows for area in window.screen.areas]
    area = next((area for area in areas if area.type == kind), None)
    if area is None:
        bpy.ops.wm.window_new()
        area = context.window_manager.windows[-1].screen.areas[0]
        area.type = kind
    area.tag_redraw()
    return area.spaces.active


def fit_image(name: str) -> bool:
    """Zoom the Image Editors that show the image with this name until all of it is seen.

    False: `clock` need not call again.
    """
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            image = area.spaces.active.image if area.type == "IMAGE_EDITOR" else None
            if image is not None and image.name == name:
                region = next(region for region in area.regions if region.type == "WINDOW")
                with bpy.context.temp_override(window=window, area=area, region=region):
                    bpy.ops.image.view_all(fit_view=True)
    return False
