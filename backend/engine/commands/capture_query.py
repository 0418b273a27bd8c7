"""Asks the engine about a capture (`blender_nep info CAPTURE --json`) without blocking Blender. No bpy in this file."""

import json
import shutil
import subprocess
import tempfile
import threading
from pathlib import Path
from typing import Any

from ..command import ENGINE_MODULE, EngineError, NoEngineError, engine_environment, find_engine_python, info_arguments
from ..install import NEUTRAL_FOLDER

NO_ANSWER = "The engine could not look at the capture."
OUTDATED = "The installed engine is older than this add-on, and cannot check photos."
UNKNOWN_OPTION = "unrecognized arguments"
"""What an engine prints that does not know an option."""


class CaptureQuery:
    """Asks the engine what it knows of a capture, in a thread.

    When `poll` returns True, the answer is there: either `error`, or `found` (what `info --json` prints) and `sphere`
    (center, radius).
    """

    def __init__(self, capture: Path, configured_python: str, *, picture: bool = False, bounds: tuple[str, ...] = ()):
        """`configured_python`: the engine's Python of the add-on's preferences, or an empty string.

        `picture`: also draw the directions of the photos; the file `self.picture` is there until `close`. `bounds`:
        arguments with the object's sphere, in place of the capture's own.
        """
        self.found: dict[str, Any] | None = None
        self.sphere: tuple[list[float], float] | None = None
        self.error: EngineError | None = None
        self.picture = Path(tempfile.mkdtemp(prefix="nep_")) / "coverage.png" if picture else None
        self._arguments = info_arguments(capture, picture=self.picture, bounds=bounds)
        self._configured = configured_python
        self._process: subprocess.Popen | None = None
        self._closed = False
        self._lock = threading.Lock()
        self._thread = threading.Thread(target=self._ask, daemon=True)
        self._thread.start()

    def _ask(self) -> None:
        try:
            python = find_engine_python(configured=self._configured)
            with self._lock:
                if self._closed:
                    return
                self._process = subprocess.Popen(
                    [python, "-I", "-m", ENGINE_MODULE, *self._arguments],
                    cwd=NEUTRAL_FOLDER,
                    env=engine_environment(),
                    stdin=subprocess.DEVNULL,
                    text=True,
                    stdout=subprocess.PIPE,
                    stderr=subprocess.PIPE,
                    encoding="utf-8",
                    creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
                )
            self._read_answer(*self._process.communicate())
        except EngineError as error:
            self.error = error
        except OSError as error:
            self.error = NoEngineError(f"The engine cannot be started: {error}.")

    def _read_answer(self, output: str, log: str) -> None:
        try:
            found = json.loads(output)
            if "error" in found:
                told = found["error"]
                name, values = str(told.get("name", "")), told.get("values") or {}
                self.error = EngineError(int(told["code"]), told["message"], told["hint"], name=name, values=values)
            else:
                self.sphere = found["object_center"], found["object_radius"]
                self.found = found
        except (ValueError, KeyError, TypeError, AttributeError):
            last = "".join(log.strip().splitlines()[-1:])
            outdated = UNKNOWN_OPTION in last
            self.error = NoEngineError(OUTDATED) if outdated else EngineError(1, NO_ANSWER, log=last)

    def poll(self) -> bool:
        """Return True when the answer is there."""
        return not self._thread.is_alive()

    def close(self) -> None:
        """Stop waiting for the answer, and remove the picture. An engine that is still reading photos is killed."""
        with self._lock:
            self._closed = True
            if self._process and self._process.poll() is None:
                self._process.kill()
        if self.picture is not None:
            shutil.rmtree(self.picture.parent, ignore_errors=True)
