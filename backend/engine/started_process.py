"""A process that this program starts and follows by files, so that nothing ever waits for a pipe. No bpy in this file."""

import json
import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from .command import engine_environment


class StartedProcess:
    """`command`, with its standard output in `folder`/events.jsonl and its standard error in `folder`/engine.log.

    It hears of our end, wanted or not, by the end of its standard input; with `keep_going` it has none and lives on.
    OSError where it cannot be started.
    """

    def __init__(self, command: list[str], keep_going: bool = False):
        self.command = command
        self.folder = Path(tempfile.mkdtemp(prefix="nep_"))
        with open(self.folder / "events.jsonl", "wb") as events, open(self.folder / "engine.log", "wb") as log:
            # its own session: Ctrl-C in a terminal reaches the parent alone, which then asks the process to stop
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
        """By standard input; False where it does not listen."""
        if self.process.stdin is None:
            return False
        try:
            self.process.stdin.write(json.dumps({"cmd": "stop"}).encode() + b"\n")
            self.process.stdin.flush()
        except OSError:
            return False
        return True

    def send(self, kill: bool) -> None:
        """The operating system's way to end it."""
        if kill:
            self.process.kill()
        else:
            self.process.terminate()

    def close(self) -> None:
        """Let go of it, and of its first files."""
        if self.process.stdin is not None:
            try:
                self.process.stdin.close()
            except OSError:
                pass  # it is gone, and so is who would have read what was left to write
        shutil.rmtree(self.folder, ignore_errors=True)  # Windows keeps what is still open
