"""What the scripts that run inside a Blender of their own share. No bpy at module level: pytest reads this folder too."""

import time

LIMIT_S = 120


def fails(call, message: str) -> None:
    """An operator that reports an error raises RuntimeError in Python."""
    try:
        call()
    except RuntimeError as error:
        assert message in str(error), error
    else:
        raise AssertionError(f"no error told of: {message}")


def rounds(addon, until) -> None:
    """Rounds of the add-on's timer, which never fires without an event loop, until something holds."""
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
