"""A process that this program starts and follows by files: neither ever waits for a pipe. No bpy in this file."""

import json
import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from .command import engine_environment


class StartedProcess:
    """`command`, with its standard output in `folder`/events.jsonl and its standard error in `folder`/engine.log.

    When this program ends, or crashes, the process's standard input is closed; that tells it to end too. With `keep_going`
    it has no standard input and goes on. OSError where it cannot be started.
    """

    def __init__(self, command: list[str], keep_going: bool = False):
        self.command = command
        self.folder = Path(tempfile.mkdtemp(prefix="nep_"))
        with open(self.folder / "events.jsonl", "wb") as events, open(self.folder / "engine.log", "wb") as log:
            # its own session: Ctrl-C in a terminal reaches this program alone, which then asks the process to stop
            self.process = subprocess.Popen(
                command,
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
        """The exit code, negative for a signal."""
        return self.process.returncode

    def ask_to_stop(self) -> bool:
        """Ask by its standard input. False where it has none, or has closed it."""
        if self.process.stdin is None:
            return False
        try:
            self.process.stdin.write(json.dumps({"cmd": "stop"}).encode() + b"\n")
            self.process.stdin.flush()
        except OSError:
            return False
        return True

    def send(self, kill: bool) -> None:
        """End it by the operating system: `kill` at once, otherwise so that it can still react."""
        if kill:
            self.process.kill()
        else:
            self.process.terminate()

    def close(self) -> None:
        """Close its standard input and remove the temporary folder."""
        if self.process.stdin is not None:
            try:
                self.process.stdin.close()
            except OSError:
                pass  # the process has ended: nobody reads the rest
        shutil.rmtree(self.folder, ignore_errors=True)  # on Windows files that are still open stay
