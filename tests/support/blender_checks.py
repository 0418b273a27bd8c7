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
