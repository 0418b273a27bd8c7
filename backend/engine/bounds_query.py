"""Asks the engine where the object is (`blender_nep info CAPTURE --json`) without blocking Blender. No bpy in this file."""

import json
import subprocess
import threading
from pathlib import Path

from .command import ENGINE_MODULE, EngineError, engine_environment, find_engine_python


class BoundsQuery:
    """Asks the engine for the object's sphere, in a thread.

    When `poll` returns True, the answer is there: either `sphere` (center, radius) or `error` is set.
    """

    def __init__(self, capture: Path, configured_python: str):
        """`configured_python`: the engine's Python of the add-on's preferences, or an empty string."""
        self.sphere: tuple[list[float], float] | None = None
        self.error = ""
        self._capture, self._configured = capture, configured_python
        self._process: subprocess.Popen | None = None
        self._closed = False
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._ask, daemon=True)
        self._thread.start()

    def _ask(self) -> None:
        try:
            python = find_engine_python(configured=self._configured)
            command = [python, "-I", "-m", ENGINE_MODULE, "info", str(self._capture), "--json"]
            with self._lock:
                if self._closed:
                    return
                self._process = subprocess.Popen(
                    command,
                    env=engine_environment(),
                    stdin=subprocess.DEVNULL,
                    text=True,
                    stdout=subprocess.PIPE,
                    stderr=subprocess.PIPE,
                    encoding="utf-8",
                )
            self._read_answer(*self._process.communicate())
        except (EngineError, OSError) as error:
            self.error = str(error)

    def _read_answer(self, output: str, log: str) -> None:
        try:
            found = json.loads(output)
            if "error" in found:
                self.error = f"{found['error']['message']}\n{found['error']['hint']}".strip()
            else:
                self.sphere = found["object_center"], found["object_radius"]
        except (ValueError, KeyError):
            last = log.strip().splitlines()[-1:]
            self.error = "\n".join(["The engine could not look at the capture.", *last])

    def poll(self) -> bool:
        """Return True when the answer is there."""
        return not self._thread.is_alive()

    def close(self) -> None:
        """Stop waiting for the answer. An engine that is still reading photos is killed."""
        with self._lock:
            self._closed = True
            if self._process and self._process.poll() is None:
                self._process.kill()
