"""Entries in Blender's own menus. The search of menus (F3) finds what stands in one."""

import bpy


def draw_import(menu: bpy.types.Menu, context: bpy.types.Context) -> None:
    """In File > Import."""
    menu.layout.operator("nep.choose_folder", text="Photos of a Glossy Object (NeP)")


def draw_object(menu: bpy.types.Menu, context: bpy.types.Context) -> None:
    """In the menu Object of the 3D viewport."""
    menu.layout.separator()
    menu.layout.operator("nep.reconstruct", icon="SHADING_RENDERED")


def _places() -> tuple[tuple[type, object], ...]:
    return (bpy.types.TOPBAR_MT_file_import, draw_import), (bpy.types.VIEW3D_MT_object, draw_object)


def add() -> None:
    """Put the entries into the menus."""
    for menu, draw in _places():
        menu.append(draw)


def remove() -> None:
    """Undo `add`."""
    for menu, draw in _places():
        menu.remove(draw)
