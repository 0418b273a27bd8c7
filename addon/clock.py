"""The one timer of the add-on: every 0.1 s it calls whoever has something to look after, and rests when nobody has.

Registered functions survive File > New; none of them may keep a reference to Blender's data between two calls.
"""

import time
from collections.abc import Callable

import bpy

PERIOD_S = 0.1

REDRAW_PERIODS = 10  # a sidebar costs more to draw than there is new to see in 0.1 s

_watched: list[Callable[[], bool]] = []
_rounds = 0
_stale = False


def watch(function: Callable[[], bool]) -> None:
    """Call it every period until it returns False."""
    if function not in _watched:
        _watched.append(function)
    # without an event loop timers never fire: scripts call `tick` themselves
    if not bpy.app.background and not bpy.app.timers.is_registered(tick):
        bpy.app.timers.register(tick, first_interval=PERIOD_S, persistent=True)


def look_after(task, *, wait: bool) -> None:
    """Follow a task to its end: poll() says whether it has ended, then finish() is called once; the sidebars are drawn
    again when what shown() returns has changed. `wait`, for scripts: return afterwards."""
    seen = task.shown()

    def advance() -> bool:
        nonlocal seen
        ended = task.poll()
        if ended or task.shown() != seen:
            seen = task.shown()
            redraw_soon()
        if ended:
            task.finish()
        return not ended

    if not wait:
        watch(advance)
        return
    while advance():
        time.sleep(PERIOD_S)


def tick() -> float | None:
    """One round. Returns the time to the next one for Blender's timer, None when nothing is left to do."""
    global _rounds, _stale
    _rounds += 1
    for function in list(_watched):
        if not function():
            _watched.remove(function)
    if _stale and (_rounds % REDRAW_PERIODS == 0 or not _watched):
        _stale = False
        redraw()
    return PERIOD_S if _watched else None


def stop() -> None:
    """A timer that is still registered when Blender ends makes it hang or crash."""
    _watched.clear()
    if bpy.app.timers.is_registered(tick):
        bpy.app.timers.unregister(tick)


def redraw_soon() -> None:
    """The sidebars show something old."""
    global _stale
    _stale = True


def redraw(area_type: str = "VIEW_3D") -> None:
    """Draw the sidebars (or, in other areas, everything) again."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == area_type:
                for region in area.regions:
                    if region.type == "UI" or area_type != "VIEW_3D":
                        region.tag_redraw()
