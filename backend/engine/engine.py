"""Starts and follows the engine: `python -m blender_nep` in another process, whose Python has torch. No bpy in this file.

Blender follows the engine by two files, so that nothing is lost when Blender ends. One file holds the engine's events (JSON
lines: job, progress, preview, scene, warning, done, error), the other its log. The two files lie in a temporary folder until
the engine has accepted the output folder, and after that in `OUT/job/`. There `Engine.attach` finds a running or ended job
again.
"""

import os
import re
import shutil
import signal
import socket
import time
from pathlib import Path

from .command import ENGINE_MODULE, EngineError, NoEngineError
from .exit_codes import OUTPUT_FAILED, STOPPED
from .printed_text import one_line
from .results.job_files import FOLDER, EventFile, is_running, last_lines, make_file, read_job
from .started_process import StartedProcess

STOP_GRACE_S = 45.0  # time to write the checkpoint after a request to stop; after it the process is terminated
TERMINATE_GRACE_S = 10.0  # time to end after the process was terminated; after it the process is killed
FULL_DISK_BYTES = 1 << 20
RESUME = "Resume goes on from its last checkpoint, if there is one."


class FoundProcess:
    """An engine process at work in `out` that another program, or an earlier session of Blender, has started."""

    code = None  # only the program that started a process learns its exit code
    command = ("of an earlier session",)

    def __init__(self, out: Path, pid: int, host: str):
        """`host`: the name of the computer on which the process runs; empty where it is not known."""
        self.out, self.pid = out, pid
        self._is_here = host in ("", socket.gethostname())

    def running(self) -> bool:
        return is_running(self.out)

    def ask_to_stop(self) -> bool:
        return False

    def send(self, kill: bool) -> None:
        # Otherwise another process may have this process number by now, or has it on this computer.
        if self._is_here and self.running():
            try:
                os.kill(self.pid, getattr(signal, "SIGKILL", signal.SIGTERM) if kill else signal.SIGTERM)
            except OSError:
                return  # the process has just ended

    def close(self) -> None:
        """Do nothing: this object holds no files and no pipes."""


class Engine:
    """Follows one engine process by the files that it writes. No method waits for the process."""

    def __init__(self, process: StartedProcess | FoundProcess, folder: Path, in_output: bool):
        self._process, self._in_output = process, in_output
        self.folder = folder
        self._events = EventFile(folder / "events.jsonl")
        self.error: EngineError | None = None
        self.asset: str | None = None
        self._stop_asked: float | None = None
        self._stop_grace_s = STOP_GRACE_S
        self._terminated = False

    @classmethod
    def start(cls, python: str, arguments: list[str], *, keep_going: bool = False) -> "Engine":
        """Start the engine. With `keep_going` the engine goes on when this program ends.

        Raises NoEngineError where the engine cannot be started.
        """
        try:
            process = StartedProcess([python, "-I", "-m", ENGINE_MODULE, *arguments], keep_going)
        except OSError as error:
            raise NoEngineError(f"The engine cannot be started: {error}.") from error
        return cls(process, process.folder, in_output=False)

    @classmethod
    def attach(cls, out: Path) -> "Engine | None":
        """The running or ended job of the output folder `out`; None where the folder has no job.

        `poll` then gives all events of that job, from its first one.
        """
        job = read_job(out)
        if job is None:
            return None
        process = FoundProcess(Path(out), job["pid"], str(job.get("host", "")))
        return cls(process, Path(out) / FOLDER, in_output=True)

    @property
    def log(self) -> Path:
        """The file with what the engine and its libraries print."""
        return self.folder / "engine.log"

    def poll(self) -> tuple[list[dict], bool]:
        """(events since the last call, True when the engine has ended and all its events were read)."""
        ended = not self._process.running()
        new = self._events.read()
        for event in new:
            if event["event"] == "job":
                self.folder, self._in_output = Path(str(event.get("folder"))), True
                self._events = EventFile(self.folder / "events.jsonl")
                new = new + self._events.read()
                break
        for event in new:
            if event["event"] == "done":
                self.asset = str(event.get("asset", ""))
            elif event["event"] == "error":
                self.error = EngineError(
                    int(event.get("code") or 1),
                    one_line(event.get("message", "")),
                    "\n".join(map(one_line, str(event.get("hint", "")).split("\n"))),
                    name=str(event.get("name", "")),
                    values=event.get("values"),
                )
        if not ended and self._stop_asked is not None:
            self._enforce_stop(time.monotonic() - self._stop_asked)
        return new, ended

    def request_stop(self, grace_s: float | None = None) -> None:
        """Ask the engine to write its checkpoint and to end.

        If the engine does not end within `grace_s` seconds, later calls of `poll` terminate it, then kill it.
        """
        if self._stop_asked is not None:
            return
        self._stop_grace_s = STOP_GRACE_S if grace_s is None else grace_s
        self._stop_asked = time.monotonic()
        asked = self._process.ask_to_stop()
        if self._in_output:
            try:
                make_file(self.folder / "stop")
                asked = True
            except OSError:
                pass  # the disk is full, or the folder is gone: only a signal can stop the engine now
        if not asked:
            self._terminate()

    def _enforce_stop(self, waited: float) -> None:
        if waited > self._stop_grace_s + TERMINATE_GRACE_S:
            self._process.send(kill=True)
        elif waited > self._stop_grace_s:
            self._terminate()

    def _terminate(self) -> None:
        if not self._terminated:
            self._terminated = True
            self._process.send(kill=False)

    def outcome(self, retry: str = RESUME) -> EngineError | None:
        """What went wrong; None where an asset was made. Call this after the engine has ended.

        `retry`: the hint where the engine ended and said no reason.
        """
        if self.asset is not None:
            return None
        if self.error is not None:
            return self.error
        code, tail = self._process.code, last_lines(self.log, 5)
        if code == STOPPED or (self._stop_asked is not None and code == -signal.SIGTERM):
            return EngineError(STOPPED, "Stopped.", "Resume goes on from the last checkpoint, if there is one.")
        missing = _missing_module_error(self._process.command[0], tail)
        return self._output_error() or missing or _unexplained_end(code, tail, retry)

    def _output_error(self) -> EngineError | None:
        if not self._in_output:
            return None
        if not self.folder.is_dir():
            return EngineError(
                OUTPUT_FAILED,
                f"The output folder {self.folder.parent} is gone.",
                "Bring it back and resume, or start again with another one.",
            )
        if shutil.disk_usage(self.folder).free < FULL_DISK_BYTES:
            out = self.folder.parent
            message, hint = f"The disk of {out} is full.", "Free some space, then resume."
            return EngineError(OUTPUT_FAILED, message, hint, name="output.disk_full", values={"path": str(out)})
        return None

    def close(self) -> None:
        """Stop following the engine. An engine that was started without `keep_going` then writes its checkpoint and ends."""
        self._process.close()


def _missing_module_error(python: str, tail: str) -> EngineError | None:
    missing = re.search(r"No module named '?([\w.]+)", tail)
    if missing is None:
        return None
    return NoEngineError(f"The engine's Python {python} lacks {missing[1].partition('.')[0]}.")


def _unexplained_end(code: int | None, log: str, hint: str) -> EngineError:
    if code is None:
        return EngineError(1, "The engine ended and said no reason: it was killed, or the computer restarted.", hint, log)
    if code == -getattr(signal, "SIGKILL", 0):
        return EngineError(128 - code, "The engine was killed: the memory was full, or somebody ended it.", hint, log)
    if code < 0:
        return EngineError(128 - code, f"The engine crashed (signal {-code}).", hint, log)
    return EngineError(code or 1, f"The engine ended with code {code} and said no reason.", hint, log)
