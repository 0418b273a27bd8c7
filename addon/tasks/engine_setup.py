"""The check and the installation of the engine. Both run in other processes, so that Blender never waits for them."""

import shutil
import sys
from pathlib import Path

import bpy

from ...backend.engine import install as installer
from ...backend.engine.check import EngineCheck
from ...backend.engine.results.job_files import EventFile, last_lines
from ...backend.engine.started_process import StartedProcess
from ..engine_paths import addon_preferences
from . import registry
from .registry import Task

EXTENSION = Path(__file__).resolve().parent.parent.parent
ALLOW_ONLINE_ACCESS = "It is a download: allow it in Preferences, System, Network, Allow Online Access"
CANCEL_GRACE_PERIODS = 3000  # of the clock, 300 s: a cancelled installation may have gigabytes to delete


class PreferencesTask(Task):
    """A task that the preferences show. They are not part of any .blend file."""

    shown_in = "PREFERENCES"

    def outlives_file(self) -> bool:
        return True


class PythonCheck(PreferencesTask):
    """A question to a Python which parts of the engine it has. `answer` is there when the check has ended."""

    def __init__(self, python: str) -> None:
        super().__init__()
        self.answer = EngineCheck(python)

    def poll(self) -> bool:
        return self.answer.poll()

    def close(self) -> None:
        self.answer.close()


class Installation(PreferencesTask):
    """An installer process.

    `python` is the result of a success. `replaced` is the Engine Python that the preferences named until then. `error`
    (message, hint) tells of a failure.
    """

    def __init__(self, command: list[str], log: Path) -> None:
        """Start `command`. OSError where the process cannot be started. `log`: where the log of a failure is kept."""
        super().__init__()
        self.process = StartedProcess(command)
        self._log = log
        self._events = EventFile(self.process.folder / "events.jsonl")
        self.fraction, self.message = 0.0, "Starting"
        self.python, self.replaced = "", ""
        self.error: tuple[str, str] | None = None
        self._periods_since_cancel = 0  # 0: nobody has cancelled

    @property
    def cancelling(self) -> bool:
        """Whether somebody has cancelled the installation."""
        return self._periods_since_cancel > 0

    def poll(self) -> bool:
        ended = not self.process.running()
        for event in self._events.read():
            if event["event"] == "progress":
                self.fraction, self.message = float(event["fraction"]), str(event["message"])
            elif event["event"] == "done":
                self.python = str(event["python"])
            elif event["event"] == "error":
                self.error = str(event["message"]), str(event["hint"])
        if ended:
            if not self.python and self.error is None:
                last_line = last_lines(self.process.folder / "engine.log", 1)
                hint = last_line or "Install again: the installation then starts from the beginning."
                self.error = "The installation ended and gave no reason.", hint
            if self.error is not None and not self.cancelling:
                self._keep_log()
            self.process.close()
        elif self.cancelling:
            self._periods_since_cancel += 1
            if self._periods_since_cancel > CANCEL_GRACE_PERIODS:
                self.process.send(kill=True)
        return ended

    def displayed_state(self) -> object:
        return self.fraction, self.message

    def finish(self) -> None:
        if self.python:
            self.replaced = _forget_chosen_python()
            start_check(self.python)

    def close(self) -> None:
        """An installation that is under way cleans up and ends."""
        self.process.close()

    def _keep_log(self) -> None:
        """Save what pip has printed, and add to the hint where it is: the process's own folder is removed."""
        try:
            self._log.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(self.process.folder / "engine.log", self._log)
        except OSError:
            return  # for example, the disk is full; the message stands alone then
        message, hint = self.error
        self.error = message, f"{hint}\nLog: {self._log}".strip()

    def cancel(self) -> None:
        """Ask the installer to remove what it has made, and to end."""
        self.message = "Cancelling: removing what was made"
        self._periods_since_cancel = 1
        self.process.ask_to_stop()


def start_check(python: str) -> None:
    """Start a process that finds out which parts of the engine this Python has."""
    registry.start(PythonCheck(python))


def start_installation(folder: Path, base_python: str, build: str) -> None:
    """Start a process that installs the engine into `folder`. OSError where the process cannot be started."""
    command = [sys.executable, "-I", installer.__file__, "--source", str(EXTENSION), "--folder", str(folder)]
    log = folder / f"{installer.NAME}.log"
    registry.start(Installation([*command, "--python", base_python, "--build", build], log))


def _forget_chosen_python() -> str:
    """Let jobs use the engine that was just installed. Returns the Engine Python that was chosen before, if any."""
    preferences = addon_preferences(bpy.context)
    if preferences is None or not preferences.engine_python:
        return ""
    chosen, preferences.engine_python = preferences.engine_python, ""
    bpy.context.preferences.is_dirty = True  # so that Blender saves it
    return chosen
