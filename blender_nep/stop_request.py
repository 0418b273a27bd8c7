"""The request that a job stops. A signal, a line on standard input, its end, or a file can make the request."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from blender_nep.safety.plain_files import parse_json

INPUT_CLOSED = "standard input was closed"
"""The reason for the stop if the program that started the job has ended."""


class StopRequest:
    """Whether somebody has asked the job to stop: by SIGTERM, SIGINT, {"cmd": "stop"}, the end of standard input, a file."""

    def __init__(self) -> None:
        self._event = threading.Event()
        self.reason = ""

    @property
    def requested(self) -> bool:
        """Whether a stop was asked for."""
        return self._event.is_set()

    def request(self, reason: str) -> None:
        """Ask the job to write its checkpoint and end. The first reason is kept."""
        self.reason = self.reason or reason
        self._event.set()

    @contextmanager
    def signals(self) -> Iterator[StopRequest]:
        """Within this context, SIGTERM and the first SIGINT (Ctrl-C) ask for a stop. A second Ctrl-C interrupts at once."""

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
        """Listen for lines {"cmd": "stop"} on a file descriptor (standard input). Its end also asks for a stop.

        Standard input ends when the program that started the job ends.
        """
        threading.Thread(target=self._listen, args=(descriptor,), daemon=True).start()

    def watch_file(self, path: Path) -> None:
        """Ask for a stop as soon as there is a file `path`."""
        threading.Thread(target=self._look_for, args=(path,), daemon=True).start()

    def _look_for(self, path: Path) -> None:
        while not self._event.wait(0.3):
            if path.exists():
                self.request("stop file")

    def _listen(self, descriptor: int) -> None:
        # os.read and not sys.stdin: a thread that waits in a buffered reader makes the interpreter abort at exit
        rest = b""
        while received := _read(descriptor):
            *lines, rest = (rest + received).split(b"\n")
            for line in lines:
                try:
                    command = parse_json(line)
                except ValueError:
                    continue
                if isinstance(command, dict) and command.get("cmd") == "stop":
                    self.request("stop command")
        self.request(INPUT_CLOSED)


def _read(descriptor: int) -> bytes:
    """The next bytes; none at the end, and where the descriptor is closed."""
    try:
        return os.read(descriptor, 4096)
    except OSError:
        return b""
