"""Listens for requests to stop a script, and tells people what it does."""

import os
import signal
import sys
import threading

from ..engine.printed_text import one_line


def say(*lines: str) -> None:
    """Tell people some lines. Control characters in them are escaped, line breaks among them."""
    print(*map(one_line, lines), sep="\n", file=sys.stderr, flush=True)


class StopRequests:
    """Listens for requests to stop this program, and sets `asked` when one comes.

    A request is SIGTERM, SIGINT or, if `watch_stdin` is true, the end of standard input.
    """

    def __init__(self, watch_stdin: bool):
        self.asked = threading.Event()
        self.previous = {number: signal.signal(number, self._on_signal) for number in (signal.SIGTERM, signal.SIGINT)}
        if watch_stdin:
            threading.Thread(target=self._watch, daemon=True).start()

    def _on_signal(self, number: int, frame: object) -> None:
        self.asked.set()

    def _watch(self) -> None:
        while os.read(sys.stdin.fileno(), 4096):
            continue
        self.asked.set()
