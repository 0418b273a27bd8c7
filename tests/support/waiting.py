"""Waiting for something that another process does, with a limit."""

import time
from collections.abc import Callable

LIMIT_S = 120


def wait_until(condition: Callable[[], object], limit_s: float = LIMIT_S) -> None:
    """Return as soon as `condition()` is true. AssertionError after `limit_s` seconds."""
    deadline = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < deadline, f"still waiting after {limit_s} s"
        time.sleep(0.02)
