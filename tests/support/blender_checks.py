"""Helpers of the scripts that run inside Blender. No bpy at module level, because pytest reads this folder too."""

import time

LIMIT_S = 120


def fails(call, message: str) -> None:
    """Assert that an operator reports an error with this message. Such an operator raises RuntimeError in Python."""
    try:
        call()
    except RuntimeError as error:
        assert message in str(error), error
    else:
        raise AssertionError(f"no error told of: {message}")


def rounds(addon, until) -> None:
    """Call the add-on's timer until `until()` is true. Without an event loop, Blender never calls the timer itself."""
    deadline = time.monotonic() + LIMIT_S
    while not until():
        assert time.monotonic() < deadline, "nothing came"
        addon.clock.tick()
        time.sleep(0.02)


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
