"""Draws pictures that consist of two halves, as wide as the sidebar allows."""

import bpy

from ..halved_pictures import picture_halves
from ..wrapped_text import draw_wrapped, panel_width

ROW_HEIGHT = 20  # in pixels at an interface scale of 1; template_icon counts in rows


def draw_halves(layout: bpy.types.UILayout, context: bpy.types.Context, key: str, titles: tuple[str, str]) -> None:
    """Draw the halves of the picture with this key, each above its title. Without such a picture, nothing is drawn."""
    row = layout.row()
    halves = picture_halves(key)
    for picture, title in zip(halves, titles, strict=False):
        column = row.column(align=True)
        column.template_icon(picture.icon_id, scale=max(3, panel_width(context) / len(halves) / ROW_HEIGHT))
        draw_wrapped(column, context, title, parts=len(halves))
