"""Texts in the sidebar that are wider than the sidebar: they are broken into lines, or shorter ones are taken."""

from collections.abc import Callable

import blf
import bpy
from bpy.app.translations import pgettext_iface

MARGINS = 64  # of a panel in a sidebar, with the sidebar's tabs; in pixels at an interface scale of 1
ICON = 20  # width of an icon, in the same pixels
UNKNOWN_WIDTH = 280  # of a sidebar, where the context has no region
NARROW = 200  # a panel with less width has the names of settings above their fields
BUTTON = 16  # margins of a text in a button, in pixels at an interface scale of 1
STEADY_LINES = 4  # what a running search or job says of itself, where one of its three texts is wrapped
SHORTEST_LINE = "m" * 6  # a line is never narrower than this text


def panel_width(context: bpy.types.Context) -> float:
    """The width for the content of a panel in the context's region, in pixels at an interface scale of 1."""
    width = context.region.width if context.region else UNKNOWN_WIDTH
    return width / context.preferences.system.ui_scale - MARGINS


def draw_wrapped(
    layout: bpy.types.UILayout, context: bpy.types.Context, text: str, icon: str = "NONE", *, parts: int = 1
) -> None:
    """Draw a text in as many lines as the sidebar's width needs, with the icon before the first line.

    `parts`: how many such texts stand side by side. An empty text draws nothing. Blender translates the lines of labels
    only, so the whole text is translated before.
    """
    limit = panel_width(context) / parts - (ICON if icon != "NONE" else 0)
    column = _dense(layout)
    for index, line in enumerate(_lines(context, pgettext_iface(text), limit)):
        column.label(text=line, icon=icon if index == 0 else "BLANK1" if icon != "NONE" else "NONE")


def draw_steady(layout: bpy.types.UILayout, context: bpy.types.Context, texts: list[str]) -> None:
    """Draw texts that change while somebody looks, and empty lines below them until there are STEADY_LINES.

    So the buttons below do not move under the mouse. The texts are translated already.
    """
    column, lines = _dense(layout), [line for text in texts for line in _lines(context, text, panel_width(context))]
    for line in lines + [""] * (STEADY_LINES - len(lines)):
        column.label(text=line)


def _dense(layout: bpy.types.UILayout) -> bpy.types.UILayout:
    column = layout.column(align=True)
    column.scale_y = 0.8
    return column


def _lines(context: bpy.types.Context, text: str, limit: float) -> list[str]:
    blf.size(0, context.preferences.ui_styles[0].widget.points)
    return wrap(text, limit, lambda words: blf.dimensions(0, words)[0])


def fitting(context: bpy.types.Context, *texts: str, parts: float = 1) -> str:
    """The first of the texts that fits into a button with an icon, in the panel's language; else the last one.

    `parts`: how many buttons of this width share the line.
    """
    blf.size(0, context.preferences.ui_styles[0].widget.points)
    limit = panel_width(context) / parts - ICON - BUTTON
    translated = [pgettext_iface(text) for text in texts]
    return next((text for text in translated if blf.dimensions(0, text)[0] <= limit), translated[-1])


def draw_setting(
    layout: bpy.types.UILayout, context: bpy.types.Context, settings: bpy.types.PropertyGroup, name: str, **options: object
) -> None:
    """Draw a setting with its name beside its field, or above it in a narrow sidebar. `options`: those of `prop`."""
    kind = settings.bl_rna.properties[name]
    if panel_width(context) >= NARROW:
        layout.prop(settings, name, **options)
        return
    column = layout.column(align=True)
    column.use_property_split = False
    if kind.type == "BOOLEAN":
        column.prop(settings, name, **options)
        return
    column.label(text=kind.name)
    column.prop(settings, name, text="", **options)


def wrap(text: str, limit: float, width: Callable[[str], float] = len) -> list[str]:
    """Break a text between its words into lines whose `width` is at most `limit`.

    A word that is wider than a line, as paths are, is cut.
    """
    limit, lines = max(limit, width(SHORTEST_LINE)), []
    for paragraph in text.splitlines():
        line = ""
        for word in paragraph.split():
            if line and width(f"{line} {word}") > limit:
                lines.append(line)
                line = ""
            while width(word) > limit:
                cut = next(count for count in range(len(word), 0, -1) if width(word[:count]) <= limit)
                lines.append(word[:cut])
                word = word[cut:]
            line = f"{line} {word}".strip()
        if line:
            lines.append(line)
    return lines
