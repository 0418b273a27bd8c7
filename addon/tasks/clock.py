"""The add-on's one timer. Every 0.1 s it calls the functions that follow something; without such functions it stops.

A registered function survives File > New. So no registered function may keep a reference to Blender's data between
two calls.
"""

import time
import traceback
from collections.abc import Callable
from typing import Protocol

import bpy

PERIOD_S = 0.1

REDRAW_PERIODS = 10  # drawing the sidebar every 0.1 s would cost more than it shows

_functions: list[Callable[[], bool]] = []
_period_count = 0
_sidebars_are_stale = False


class Task(Protocol):
    """Something in another process or thread that `follow` can follow to its end."""

    def poll(self) -> bool:
        """Whether the task has ended."""

    def displayed_state(self) -> object:
        """What the sidebar shows of the task. The sidebar is drawn again when this value changes."""

    def finish(self) -> None:
        """Called once, after the task has ended."""


def call_until_false(function: Callable[[], bool]) -> None:
    """Call the function every period until it returns False."""
    if function not in _functions:
        _functions.append(function)
    # without an event loop Blender's timers never fire: scripts call `tick` themselves
    if not bpy.app.background and not bpy.app.timers.is_registered(tick):
        bpy.app.timers.register(tick, first_interval=PERIOD_S, persistent=True)


def follow(task: Task, *, wait: bool) -> None:
    """Poll the task every period until it ends, then finish it.

    With `wait`, for scripts, this function returns when the task has ended; else it returns at once.
    """
    displayed = task.displayed_state()

    def advance() -> bool:
        nonlocal displayed
        ended = task.poll()
        if ended or task.displayed_state() != displayed:
            displayed = task.displayed_state()
            redraw_sidebars_soon()
        if ended:
            task.finish()
        return not ended

    if not wait:
        call_until_false(advance)
        return
    while advance():
        time.sleep(PERIOD_S)


def tick() -> float | None:
    """Call all functions once. Returns the seconds to the next call, or None where no function is left.

    Blender's timer calls `tick` again after these seconds, and stops at None.
    """
    global _period_count, _sidebars_are_stale
    _period_count += 1
    for function in list(_functions):
        try:
            goes_on = function()
        except Exception:  # An error of one task must not end the following of the others, and Blender's timer.
            traceback.print_exc()
            goes_on = False
        if not goes_on:
            _functions.remove(function)
    if _sidebars_are_stale and (_period_count % REDRAW_PERIODS == 0 or not _functions):
        _sidebars_are_stale = False
        redraw("VIEW_3D")
    return PERIOD_S if _functions else None


def stop() -> None:
    """Stop the timer and forget all functions. A timer that is registered when Blender ends makes it hang or crash."""
    _functions.clear()
    if bpy.app.timers.is_registered(tick):
        bpy.app.timers.unregister(tick)


def redraw_sidebars_soon() -> None:
    """Draw the sidebars again, within REDRAW_PERIODS."""
    global _sidebars_are_stale
    _sidebars_are_stale = True


def redraw(area_type: str) -> None:
    """Draw all areas of this type again now; of 3D viewports ("VIEW_3D") only the sidebars."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == area_type:
                for region in area.regions:
                    if region.type == "UI" or area_type != "VIEW_3D":
                        region.tag_redraw()
