"""Helpers of the scripts that run inside Blender. No bpy at module level, because pytest reads this folder too."""

import atexit
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace

LIMIT_S = 120


def fails(call, message: str) -> None:
    """Assert that an operator reports an error with this message. Such an operator raises RuntimeError in Python."""
    try:
        call()
    except RuntimeError as error:
        assert message in str(error), error
    else:
        raise AssertionError(f"no error told of: {message}")


@contextmanager
def told_in(case: str) -> Iterator[None]:
    """Names the case of a loop in which an error comes."""
    try:
        yield
    except BaseException as error:
        error.add_note(f"in the case: {case}")
        raise


def register():
    """Register the add-on, which is importable as `nep_addon`, once in a process; returns its package `addon`."""
    import bpy
    import nep_addon

    if not hasattr(bpy.types.Scene, "nep"):
        nep_addon.register()
        if bpy.app.version < (5, 0):
            atexit.register(_unregister)
    from nep_addon import addon

    return addon


def _unregister() -> None:
    """As a Blender with a window does at its end. Where classes are left, the wheel 4.2 crashes at its end and 4.5 hangs."""
    import bpy
    import nep_addon

    if hasattr(bpy.types.Scene, "nep"):
        nep_addon.unregister()


def rounds(addon, until) -> None:
    """Call the add-on's timer until `until()` is true. Without an event loop, Blender never calls the timer itself."""
    deadline = time.monotonic() + LIMIT_S
    while not until():
        assert time.monotonic() < deadline, "nothing came"
        addon.tasks.clock.tick()
        time.sleep(0.02)


def with_small_light_map(world):
    """The World, for which Cycles draws directions of light from a small map.

    The map is made anew for each render of another World. Cycles' own has 4096 x 2048 cells and takes 1.1 CPU seconds.
    """
    world.cycles.sampling_method, world.cycles.sample_map_resolution = "MANUAL", 256
    return world


class Drawn:
    """A layout for a panel's `draw` that draws nothing. `log` holds the texts and operators in their order."""

    def __init__(self, log: list[str] | None = None) -> None:
        self.log: list[str] = [] if log is None else log

    def __getattr__(self, name: str):
        def note(*arguments, **keywords):
            self.log += [arguments[0]] if name == "operator" else []
            self.log += [keywords["text"]] if "text" in keywords else []
            return Drawn(self.log)

        return note

    def panel(self, *_arguments, **_keywords):
        return Drawn(self.log), Drawn(self.log)


def drawn_by(bpy, panel, **attributes) -> list[str]:
    """The texts and operators that a panel, or preferences with these attributes, draw for the scene, in their order."""
    real = bpy.context.preferences
    preferences = SimpleNamespace(system=SimpleNamespace(ui_scale=1.0), ui_styles=real.ui_styles, addons=real.addons)
    # as a screen has it
    context = SimpleNamespace(scene=bpy.context.scene, region=None, screen=None, area=None, preferences=preferences)
    layout = Drawn()
    panel.draw(SimpleNamespace(layout=layout, **attributes), context)
    return layout.log
