"""The engine: `python -m blender_nep` in another process, with its own Python that has torch. No bpy in this file.

The engine speaks JSON lines on its standard output (progress, preview, warning, done, error), writes human text and
its log to standard error, and takes {"cmd": "stop"} on standard input. A closed standard input means that Blender
died: the engine then writes its checkpoint and leaves.
"""
import json
import os
import queue
import subprocess
import sys
import threading
import time
from collections import deque
from pathlib import Path

ENGINE_PYTHON_VARIABLE = "NEP_ENGINE_PYTHON"
ENGINE_MODULE = "blender_nep"
STOPPED = 7  # exit code: stopped on request, checkpoint written
NO_ENGINE = 2
STOP_GRACE_S = 45.0  # to write a checkpoint after "stop", before the operating system is asked
TERMINATE_GRACE_S = 10.0
CHECK_LIMIT_S = 60.0
LOG_TAIL_LINES = 200


class EngineError(Exception):
    """The engine failed or cannot be started. `code` is the exit code; `hint` says what to do, or is empty."""

    def __init__(self, code: int, message: str, hint: str = ""):
        super().__init__(f"{message}\n{hint}" if hint else message)
        self.code, self.message, self.hint = code, message, hint


def engine_environment() -> dict[str, str]:
    """The environment without Blender's and its Python's variables, which would lead the engine's Python astray."""
    return {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "BLENDER_"))}


def missing_from(python: str) -> str:
    """Why this Python cannot run the engine, in words; empty where it can."""
    script = ("import importlib.util as u, sys; "
              f"sys.exit(','.join(m for m in ('{ENGINE_MODULE}', 'torch') if u.find_spec(m) is None) or 0)")
    try:
        found = subprocess.run([python, "-I", "-c", script], env=engine_environment(), stdin=subprocess.DEVNULL,
                               capture_output=True, text=True, timeout=CHECK_LIMIT_S)
    except OSError as error:
        return f"it cannot be started ({error.strerror or error})"
    except subprocess.TimeoutExpired:
        return f"it did not answer within {CHECK_LIMIT_S:.0f} s"
    if found.returncode == 0:
        return ""
    lines = found.stderr.strip().splitlines()
    return "it lacks " + lines[-1].replace(",", " and ") if lines else f"it ended with code {found.returncode}"


def find_engine_python(explicit: str | None = None, configured: str | None = None) -> str:
    """The Python that runs the engine.

    In this order: `explicit` (an argument), the variable NEP_ENGINE_PYTHON, `configured` (the add-on's preferences);
    one that is named must work. Otherwise the `.venv` of this checkout or the running Python, whichever can.
    EngineError says what is missing.
    """
    named = ((explicit, "--engine-python"), (os.environ.get(ENGINE_PYTHON_VARIABLE), ENGINE_PYTHON_VARIABLE),
             (configured, "the add-on's preferences"))
    for python, where in named:
        if python:
            reason = missing_from(python)
            if reason:
                raise EngineError(NO_ENGINE, f"The engine's Python {python} (from {where}) cannot be used: {reason}.",
                                  "Install blender-nep into it, or name another Python.")
            return python
    binary = Path("Scripts", "python.exe") if os.name == "nt" else Path("bin", "python")
    candidates = [str(Path(__file__).resolve().parent.parent / ".venv" / binary), sys.executable]
    for python in candidates:
        if python and Path(python).exists() and not missing_from(python):
            return python
    raise EngineError(NO_ENGINE, "No Python with the engine (blender-nep and torch) was found.",
                      f"Name one with --engine-python or the variable {ENGINE_PYTHON_VARIABLE}.")


class Engine:
    """One running engine process. Reader threads fill `events`; nothing here blocks but `wait_stopped`."""

    def __init__(self, python: str, arguments: list[str]):
        self.events: queue.SimpleQueue[dict] = queue.SimpleQueue()
        self.log: deque[str] = deque(maxlen=LOG_TAIL_LINES)
        self.error: EngineError | None = None
        self.asset: str | None = None
        self._stop_asked: float | None = None
        self._terminated = False
        command = [python, "-I", "-m", ENGINE_MODULE, *arguments]
        try:
            # its own session: Ctrl-C in a terminal reaches the parent alone, which then asks the engine to stop
            self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                                            stderr=subprocess.PIPE, env=engine_environment(), text=True,
                                            encoding="utf-8", errors="replace", bufsize=1,
                                            start_new_session=os.name != "nt")
        except OSError as error:
            raise EngineError(NO_ENGINE, f"The engine cannot be started: {error}") from error
        self._readers = [threading.Thread(target=reader, daemon=True) for reader in (self._read_events, self._read_log)]
        for thread in self._readers:
            thread.start()

    def _read_events(self) -> None:
        for line in self.process.stdout:
            try:
                event = json.loads(line)
            except ValueError:
                event = None
            if isinstance(event, dict) and "event" in event:
                self.events.put(event)
            else:
                self.log.append(line.rstrip("\n"))

    def _read_log(self) -> None:
        for line in self.process.stderr:
            self.log.append(line.rstrip("\n"))

    def poll(self) -> tuple[list[dict], bool]:
        """(events since the last call, whether the engine has ended and everything it said was read)."""
        ended = self.process.poll() is not None and not any(thread.is_alive() for thread in self._readers)
        new = []
        while not self.events.empty():
            event = self.events.get()
            new.append(event)
            if event["event"] == "done":
                self.asset = event.get("asset", "")
            elif event["event"] == "error":
                self.error = EngineError(int(event.get("code", 1)), str(event.get("message", "")),
                                         str(event.get("hint", "")))
        if not ended and self._stop_asked is not None:
            self._insist(time.monotonic() - self._stop_asked)
        return new, ended

    def request_stop(self) -> None:
        """Ask for a checkpoint and the end; `poll` insists (terminate, then kill) when the engine does not answer."""
        if self._stop_asked is not None:
            return
        self._stop_asked = time.monotonic()
        try:
            self.process.stdin.write(json.dumps({"cmd": "stop"}) + "\n")
            self.process.stdin.flush()
        except OSError:  # it has closed its input: it is ending, or its end will be seen by poll
            self._terminate()

    def _insist(self, waited: float) -> None:
        if waited > STOP_GRACE_S + TERMINATE_GRACE_S:
            self.process.kill()
        elif waited > STOP_GRACE_S:
            self._terminate()

    def _terminate(self) -> None:
        if not self._terminated:
            self._terminated = True
            self.process.terminate()

    def outcome(self) -> EngineError | None:
        """After the end: None where an asset was made, else what happened."""
        code = self.process.returncode
        if code == 0 and self.asset is not None:
            return None
        if self.error is not None:
            return EngineError(code if code > 0 else self.error.code, self.error.message, self.error.hint)
        if code == STOPPED:
            return EngineError(STOPPED, "Stopped; the checkpoint is written.", "Resume to go on.")
        tail = "\n".join(list(self.log)[-5:])
        if code < 0:
            return EngineError(128 - code, f"The engine was killed by signal {-code}.",
                               "Resume goes on from its last checkpoint." + (f"\n{tail}" if tail else ""))
        return EngineError(code or 1, f"The engine ended with code {code} and said no reason.", tail)

    def close(self) -> None:
        """Close the pipe: an engine that still runs sees its parent gone, writes its checkpoint and leaves."""
        try:
            self.process.stdin.close()
        except OSError:
            return


def reconstruct_arguments(capture: str, out: str, *, preset: str | None = None, device: str = "auto",
                          seed: int | None = None, masks: str | None = None, mesh: str | None = None,
                          resume: bool = False, overwrite: bool = False) -> list[str]:
    """The engine's command line for one reconstruction, ended by a closed standard input."""
    arguments = ["reconstruct", str(capture), "--out", str(out), "--device", device, "--watch-stdin"]
    for name, value in (("--preset", preset), ("--seed", seed), ("--masks", masks), ("--mesh", mesh)):
        if value is not None:
            arguments += [name, str(value)]
    return arguments + ["--resume"] * resume + ["--overwrite"] * overwrite


def is_asset(folder: Path) -> bool:
    """Whether a finished asset lies in the folder: its report is written last."""
    needed = ("mesh.obj", "textures/albedo.exr", "textures/roughness.exr", "textures/metallic.exr", "report.json")
    return all((Path(folder) / name).is_file() for name in needed)


def describe(event: dict) -> str:
    """One line for people."""
    if event["event"] == "progress":
        room = str(event.get("room", "")).replace("_", " ")
        parts = [f"{100 * float(event.get('fraction') or 0):3.0f} %", room]
        if event.get("steps"):
            parts.append(f"step {event.get('step', 0)}/{event['steps']}")
        if event.get("eta_s") is not None:
            parts.append(f"{float(event['eta_s']):.0f} s left")
        return "  ".join(parts)
    if event["event"] == "warning":
        return f"warning: {event.get('message', '')}"
    return str(event.get("message") or event.get("path") or event.get("asset") or event["event"])
