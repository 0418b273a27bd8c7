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
from . import clock

EXTENSION = Path(__file__).resolve().parent.parent.parent
ALLOW_ONLINE_ACCESS = "It is a download: allow it in Preferences, System, Network, Allow Online Access"
CANCEL_GRACE_PERIODS = 3000  # of the clock, 300 s: a cancelled installation may have gigabytes to delete


class Installation:
    """An installer process.

    `python` is the result of a success. `replaced` is the Engine Python that the preferences named until then. `error`
    (message, hint) tells of a failure.
    """

    def __init__(self, command: list[str], log: Path) -> None:
        """Start `command`. OSError where the process cannot be started. `log`: where the log of a failure is kept."""
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
        """Read what the installer has written, once every clock period; returns whether it has ended."""
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


check: EngineCheck | None = None  # the last check, or the one under way
checking = False
installation: Installation | None = None  # the last installation, or the one under way
installing = False
_displayed: tuple | None = None  # what the preferences show of these


def start_check(python: str) -> None:
    """Start a process that finds out which parts of the engine this Python has."""
    global check, checking, _displayed
    if checking:
        check.close()
    check, checking, _displayed = EngineCheck(python), True, None
    clock.call_until_false(_advance)


def forget_check() -> None:
    """Show no check: there is no Python to ask."""
    global check
    check = None


def start_installation(folder: Path, base_python: str, build: str) -> None:
    """Start a process that installs the engine into `folder`. OSError where the process cannot be started."""
    global installation, installing, _displayed
    command = [sys.executable, "-I", installer.__file__, "--source", str(EXTENSION), "--folder", str(folder)]
    installation = Installation([*command, "--python", base_python, "--build", build], folder / f"{installer.NAME}.log")
    installing, _displayed = True, None
    clock.call_until_false(_advance)


def forget_failure() -> None:
    """Show no failure of the last installation."""
    global installation
    if not installing:
        installation = None


def _advance() -> bool:
    """Follow the check and the installation, once every clock period; returns whether one of them still runs."""
    global checking, installing, _displayed
    if checking and check.poll():
        checking = False
    if installing and installation.poll():
        installing = False
        if installation.python:
            installation.replaced = _forget_chosen_python()
            start_check(installation.python)
    displayed = checking, installing, installation and (installation.fraction, installation.message)
    if displayed != _displayed:  # drawing them in each period would take the processor from the engine
        _displayed = displayed
        clock.redraw("PREFERENCES")
    return checking or installing


def _forget_chosen_python() -> str:
    """Let jobs use the engine that was just installed. Returns the Engine Python that was chosen before, if any."""
    preferences = addon_preferences(bpy.context)
    if preferences is None or not preferences.engine_python:
        return ""
    chosen, preferences.engine_python = preferences.engine_python, ""
    bpy.context.preferences.is_dirty = True  # so that Blender saves it
    return chosen


def close_all() -> None:
    """Blender or the add-on ends: the check ends, and the installation cleans up and ends."""
    global checking, installing
    if checking:
        check.close()
    if installing:
        installation.process.close()
    checking = installing = False
