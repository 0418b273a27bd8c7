"""Work beside Blender: while a task runs, one timer looks at it ten times a second; it goes when nothing runs.

A task has `poll()` -> ended, `finish()`, called once after the end, and `close()`, which lets go of it at any time.
"""
import atexit
import time

import bpy

PERIOD_S = 0.1
_tasks: list = []


def start(task) -> None:
    """Look after `task` until it has ended. Only where Blender has an event loop (not in background mode)."""
    _tasks.append(task)
    if not bpy.app.timers.is_registered(_tick):
        bpy.app.timers.register(_tick, first_interval=PERIOD_S, persistent=True)


def wait(task) -> None:
    """The same for a script: returns when the task has ended."""
    while not task.poll():
        time.sleep(PERIOD_S)
    task.finish()


def _tick() -> float | None:
    for task in list(_tasks):
        if task.poll():
            _tasks.remove(task)
            task.finish()
    redraw_sidebars()
    return PERIOD_S if _tasks else None


def redraw_sidebars() -> None:
    """Draw the panels of all 3D views again, and not the views themselves, which may take long."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            for region in area.regions if area.type == "VIEW_3D" else ():
                if region.type == "UI":
                    region.tag_redraw()


def end_all() -> None:
    """Let go of every task; no timer is left."""
    if bpy.app.timers.is_registered(_tick):
        bpy.app.timers.unregister(_tick)
    while _tasks:
        _tasks.pop().close()


def register() -> None:
    atexit.register(end_all)  # a timer that is left when the wheel's interpreter exits hangs or crashes it


def unregister() -> None:
    atexit.unregister(end_all)
    end_all()
