"""The status bar: the work under way, in every scene and file, and how it has ended, until somebody has seen it."""

import bpy

from ..tasks import registry
from ..tasks.registry import Task

MOST_SHOWN = 3
WIDTH = 8  # of a bar, in the units of `ui_units_x`


def draw_status(header: bpy.types.Header, context: bpy.types.Context) -> None:
    """What Blender calls after its own status bar was drawn."""
    layout = header.layout
    tasks = registry.tasks_of(Task)
    for task in [task for task in tasks if not task.ended and task.status_name()][-MOST_SHOWN:]:
        row = layout.row(align=True)
        row.ui_units_x = WIDTH
        row.progress(factor=task.done_fraction, text=f"{task.status_name()}: {100 * task.done_fraction:.0f} %")
    news = [task for task in tasks if task.is_news][-MOST_SHOWN:]
    for task in news:
        layout.label(text=task.end_status(), icon="ERROR" if task.has_failed else "CHECKMARK")
    if news:
        layout.operator("nep.dismiss", text="", icon="X", emboss=False)


def add() -> None:
    """Let Blender call `draw_status`."""
    bpy.types.STATUSBAR_HT_header.append(draw_status)


def remove() -> None:
    """Undo `add`."""
    bpy.types.STATUSBAR_HT_header.remove(draw_status)
