"""Runs `render_comparison.py` in a second Blender.

So the artist's Blender stays responsive, and its scene is not changed.
"""

import json
import os
import queue
import subprocess
import sys
import tempfile
import threading
import time
from collections import deque
from pathlib import Path

import bpy

from ..engine.install import NEUTRAL_FOLDER

SCRIPT = Path(__file__).resolve().parent.parent / "render_comparison.py"
KILL_AFTER_S = 5.0  # the process is killed if it still runs this long after its standard input was closed
LOG_LINES = 5  # lines from the end of the log that the message of a failure shows


class ComparisonProcess:
    """A second Blender that renders a comparison.

    When `poll` returns True, either `path` is the path of the picture, or `error` says why there is none. `poll` must be
    called in the main thread. `done` and `total` count the renders.
    """

    def __init__(self, arguments: list[str]):
        """Start the process with the command line `arguments`, whose paths are absolute.

        Raises OSError where the process cannot be started.
        """
        self.done, self.total = 0, 0
        self.path: Path | None = None
        self.error = ""
        self.cancelled = False
        self._cancelled_at = 0.0
        self._events: queue.SimpleQueue[dict] = queue.SimpleQueue()
        self._log: deque[str] = deque(maxlen=LOG_LINES)
        self._scratch = tempfile.TemporaryDirectory(prefix="nep_comparison_", ignore_cleanup_errors=True)
        # Its pictures are those of Blender's own color management, also where a studio uses another one in `OCIO`.
        # The process puts its temporary files into this folder. `close` removes the files that the process leaves behind.
        temporary = dict.fromkeys(("TMPDIR", "TEMP", "TMP"), self._scratch.name)
        self.process = subprocess.Popen(
            [*_blender(), *arguments],
            cwd=NEUTRAL_FOLDER,
            env={name: value for name, value in os.environ.items() if name != "OCIO"} | temporary,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            encoding="utf-8",
            errors="replace",
            start_new_session=os.name != "nt",
            creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
        )
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        for line in self.process.stdout:
            if line.startswith('{"event"'):
                self._events.put(json.loads(line))
            elif line.strip():
                self._log.append(line.strip())

    def poll(self) -> bool:
        """Read what the process has printed. Returns True when the process has ended."""
        ended = self.process.poll() is not None and not self._reader.is_alive()
        while not self._events.empty():
            event = self._events.get()
            if event["event"] == "progress":
                self.done, self.total = event["done"], event["total"]
            elif event["event"] == "done":
                self.path = Path(event["path"])
            elif event["event"] == "error":
                self.error = event["message"]
        if self.cancelled and not ended and time.monotonic() - self._cancelled_at > KILL_AFTER_S:
            self.process.kill()
        if ended and self.path is None and not self.error:
            code = self.process.returncode
            self.error = (
                "Cancelled"
                if self.cancelled
                else "\n".join([f"Blender ended with code {code} while rendering the comparison", *self._log])
            )
        return ended

    def cancel(self) -> None:
        """Ask the process to end. `poll` returns True when the process has ended."""
        if not self.cancelled:
            self.cancelled, self._cancelled_at = True, time.monotonic()
            self.process.stdin.close()

    def close(self) -> None:
        """Kill the process if it still runs, and remove its temporary files."""
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        self.process.stdin.close()
        self._reader.join()
        self.process.stdout.close()
        self._scratch.cleanup()


def _blender() -> list[str]:
    """The command that runs SCRIPT: this Blender's program, or this Python where bpy is a wheel, which has no program."""
    if bpy.app.binary_path:
        return [bpy.app.binary_path, "-b", "--factory-startup", "--python-exit-code", "1", "-P", str(SCRIPT), "--"]
    return [sys.executable, "-I", str(SCRIPT)]
