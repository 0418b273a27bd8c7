"""The add-on's one timer. Every 0.1 s it calls the functions that follow something; without such functions it stops.

A registered function survives File > New. So no registered function may keep a reference to Blender's data between
two calls.
"""

import traceback
from collections.abc import Callable

import bpy

PERIOD_S = 0.1

STATUS_BAR = "STATUSBAR"
REDRAW_PERIODS = 10  # drawing an area every 0.1 s would cost more than it shows

_functions: list[Callable[[], bool]] = []
_period_count = 0
_stale_areas: set[str] = set()


def call_until_false(function: Callable[[], bool]) -> None:
    """Call the function every period until it returns False."""
    if function not in _functions:
        _functions.append(function)
    # without an event loop Blender's timers never fire: scripts call `tick` themselves
    if not bpy.app.background and not bpy.app.timers.is_registered(tick):
        bpy.app.timers.register(tick, first_interval=PERIOD_S, persistent=True)


def tick() -> float | None:
    """Call all functions once. Returns the seconds to the next call, or None where no function is left.

    Blender's timer calls `tick` again after these seconds, and stops at None.
    """
    global _period_count
    _period_count += 1
    for function in list(_functions):
        try:
            goes_on = function()
        except Exception:  # An error of one must not end the calls of the others, and Blender's timer.
            traceback.print_exc()
            goes_on = False
        if not goes_on:
            _functions.remove(function)
    if _period_count % REDRAW_PERIODS == 0 or not _functions:
        while _stale_areas:
            redraw(_stale_areas.pop())
    return PERIOD_S if _functions else None


def stop() -> None:
    """Stop the timer and forget all functions. A timer that is registered when Blender ends makes it hang or crash."""
    _functions.clear()
    if bpy.app.timers.is_registered(tick):
        bpy.app.timers.unregister(tick)


def redraw_soon(area_type: str) -> None:
    """Draw all areas of this type again, as `redraw` does, within REDRAW_PERIODS."""
    _stale_areas.add(area_type)


def redraw(area_type: str) -> None:
    """Draw all areas of this type again now; of 3D viewports ("VIEW_3D") only the sidebars."""
    if area_type == STATUS_BAR:
        _redraw_status_bar()
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == area_type:
                for region in area.regions:
                    if region.type == "UI" or area_type != "VIEW_3D":
                        region.tag_redraw()


def _redraw_status_bar() -> None:
    """Draw the status bars again. Blender lists no area for them, but draws them when their text is set.

    That would take away the text of a tool that the artist is using. So the windows with such a tool are left out.
    """
    for window in () if bpy.app.background else bpy.context.window_manager.windows:
        if not len(getattr(window, "modal_operators", ())):
            with bpy.context.temp_override(window=window):  # without it, Blender 4.3 crashes after File > New
                window.workspace.status_text_set(None)
