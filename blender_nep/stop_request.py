"""The wish that a job end, and everything that may express it: a signal, a line on standard input, a file."""

from __future__ import annotations

import json
import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

INPUT_CLOSED = "standard input was closed"
"""The reason for a stop where the program that has started the job ended."""


class StopRequest:
    """Whether somebody wants the job to end: SIGTERM, SIGINT, {"cmd": "stop"} or the end of standard input."""

    def __init__(self) -> None:
        self._event = threading.Event()
        self.reason = ""

    @property
    def requested(self) -> bool:
        """True from the first wish on."""
        return self._event.is_set()

    def request(self, reason: str) -> None:
        """Ask the job to write its checkpoint and end."""
        self.reason = self.reason or reason
        self._event.set()

    @contextmanager
    def signals(self) -> Iterator[StopRequest]:
        """Within this context SIGTERM and the first SIGINT (Ctrl-C) are wishes; a second Ctrl-C interrupts at once."""

        def handle(number: int, _frame: object) -> None:
            if self.requested and number == signal.SIGINT:
                signal.default_int_handler(number, None)
            self.request(signal.Signals(number).name)

        before = {n: signal.signal(n, handle) for n in (signal.SIGTERM, signal.SIGINT)}
        try:
            yield self
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)

    def watch(self, descriptor: int = 0) -> None:
        """Listen for {"cmd": "stop"} lines on a file descriptor (standard input); its end means the parent died."""
        threading.Thread(target=self._listen, args=(descriptor,), daemon=True).start()

    def watch_file(self, path: Path) -> None:
        """Look for a file whose appearance means stop."""
        threading.Thread(target=self._look_for, args=(path,), daemon=True).start()

    def _look_for(self, path: Path) -> None:
        while not self._event.wait(0.3):
            if path.exists():
                self.request("stop file")

    def _listen(self, descriptor: int) -> None:
        # os.read, not sys.stdin: a thread that waits in a buffered reader makes the interpreter abort at its exit
        rest = b""
        while received := os.read(descriptor, 4096):
            *lines, rest = (rest + received).split(b"\n")
            for line in lines:
                try:
                    command = json.loads(line)
                except ValueError:
                    continue
                if isinstance(command, dict) and command.get("cmd") == "stop":
                    self.request("stop command")
        self.request(INPUT_CLOSED)
