"""Starts a process whose output goes to files, so that no process ever waits for a pipe. No bpy in this file."""

import json
import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from .command import engine_environment
from .install import NEUTRAL_FOLDER


class StartedProcess:
    """A running `command`. Its standard output goes to `folder`/events.jsonl, its standard error to `folder`/engine.log.

    When this program ends or crashes, the process's standard input is closed; that tells the process to end too. With
    `keep_going` the process has no standard input and goes on. Raises OSError where the process cannot be started.
    """

    def __init__(self, command: list[str], keep_going: bool = False):
        self.command = command
        self.folder = Path(tempfile.mkdtemp(prefix="nep_"))
        with open(self.folder / "events.jsonl", "wb") as events, open(self.folder / "engine.log", "wb") as log:
            # The process gets its own session, so that Ctrl-C in a terminal reaches only this program. This program then
            # asks the process to stop.
            self.process = subprocess.Popen(
                command,
                cwd=NEUTRAL_FOLDER,
                env=engine_environment(),
                stdout=events,
                stderr=log,
                stdin=subprocess.DEVNULL if keep_going else subprocess.PIPE,
                start_new_session=os.name != "nt",
                creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
            )

    def running(self) -> bool:
        return self.process.poll() is None

    @property
    def code(self) -> int | None:
        """The exit code; minus the signal's number where a signal ended the process; None while the process runs."""
        return self.process.returncode

    def ask_to_stop(self) -> bool:
        """Ask the process to stop by a line on its standard input.

        Returns False where the process has no standard input, or has closed it.
        """
        if self.process.stdin is None:
            return False
        try:
            self.process.stdin.write(json.dumps({"cmd": "stop"}).encode() + b"\n")
            self.process.stdin.flush()
        except OSError:
            return False
        return True

    def send(self, kill: bool) -> None:
        """Send the process a signal to end. With `kill` it ends at once; otherwise it can still react to the signal."""
        if kill:
            self.process.kill()
        else:
            self.process.terminate()

    def close(self) -> None:
        """Close the process's standard input and remove the temporary folder."""
        if self.process.stdin is not None:
            try:
                self.process.stdin.close()
            except OSError:
                pass  # the process has ended: nobody reads the rest
        shutil.rmtree(self.folder, ignore_errors=True)  # Windows does not remove files that are still open
