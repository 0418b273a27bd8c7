"""Editors beside the 3D view, for what a sidebar is too small for."""

import bpy


def open_editor(context, kind: str):
    """The active space of an editor of that kind ("TEXT_EDITOR", "IMAGE_EDITOR"): of one that is open, else in a window
    of its own."""
    areas = [area for window in context.window_manager.windows for area in window.screen.areas]
    area = next((area for area in areas if area.type == kind), None)
    if area is None:
        bpy.ops.wm.window_new()
        area = context.window_manager.windows[-1].screen.areas[0]
        area.type = kind
    area.tag_redraw()
    return area.spaces.active
