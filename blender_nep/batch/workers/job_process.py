"""The process of one job: `blender-nep reconstruct`, and before it `blender-nep cameras` for photos alone."""

from __future__ import annotations

import contextlib
import json
import os
import queue
import subprocess
import threading
import time
from collections import deque
from pathlib import Path

from blender_nep.batch.outcome import NOT_STARTED
from blender_nep.batch.workers.jobs import Job, JobUpdate
from blender_nep.batch.workers.machine import OUT_OF_JOB, Meter, kill
from blender_nep.errors import NepError
from blender_nep.safety.isolated_python import NEUTRAL_FOLDER

CAPTURE = "capture"
"""The folder in an asset that holds the cameras of photos alone"""
_CAMERAS_SHARE = 0.3
"""Share of the whole job that the search for cameras counts for"""
_LONGEST_STOP_S = 120.0
"""Seconds after which a job is killed that was asked to stop. Some steps cannot be interrupted."""
_LAST_WORDS = 6
"""Lines of standard error that are kept"""
_NO_PROGRAM = (FileNotFoundError, NotADirectoryError, PermissionError)
"""Errors that every start of the program meets. Others may pass: the system has no memory or no process left."""


class JobProcess:
    """Starts the process of a job, listens to it, measures it, and stops it.

    The process watches its standard input. So it stops by itself when this process ends, however that ends.
    """

    def __init__(self, job: Job, worker: str) -> None:
        """Start. Raises OSError if there is no such program."""
        self.job = job
        self._heard: list[JobUpdate] = []
        self._began = time.monotonic()
        self._peak_mb = self._cpu_seconds = 0.0
        self._error: dict | None = None
        self._asked_at: float | None = None
        self._ended = False
        found = self._cameras / "transforms.json"
        self._searching = job.photos_alone and not found.is_file()
        self._update("started", worker=worker)
        self._start()

    @property
    def _cameras(self) -> Path:
        return self.job.out / CAPTURE

    @property
    def running(self) -> bool:
        """Whether the job goes on, or something is left to be heard."""
        return not self._ended or bool(self._heard)

    def _command(self) -> list[str]:
        job, threads = self.job, ("--threads", str(self.job.threads), "--watch-stdin")
        if self._searching:
            return [*job.engine, "cameras", str(job.capture), "--out", str(self._cameras), *threads]
        capture = self._cameras if job.photos_alone else job.capture
        return [*job.engine, "reconstruct", str(capture), "--out", str(job.out), "--resume", *job.options, *threads]

    def _start(self) -> None:
        """Start the program. If the system cannot do so now, the job has ended."""
        self._error = None
        try:
            self._open()
        except _NO_PROGRAM:
            raise
        except (OSError, RuntimeError) as error:  # RuntimeError: there is no thread left
            reason = getattr(error, "strerror", None) or str(error)
            hint = "Close other programs, or try fewer --workers."
            said = NepError(f"the job's process could not be started: {reason}", hint, NOT_STARTED, reason=reason)
            self._error = said.to_dict()
            self._end(said.code, "", {"peak_mb": self._peak_mb, "cpu_seconds": self._cpu_seconds})

    def _open(self) -> None:
        # Ctrl-C in a terminal reaches a whole group of processes. A group of its own leaves it to us to stop the job.
        self._process = subprocess.Popen(
            self._command(),
            cwd=NEUTRAL_FOLDER,
            env=os.environ | {OUT_OF_JOB: str(self.job.out)},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            start_new_session=os.name != "nt",
        )
        self._lines: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        self._words: deque[bytes] = deque(maxlen=_LAST_WORDS)
        process, lines, words = self._process, self._lines, self._words

        def listen() -> None:
            for line in process.stdout or ():
                lines.put(line)

        targets = (listen, lambda: words.extend(process.stderr or ()))
        self._readers = [threading.Thread(target=target, daemon=True) for target in targets]
        try:
            for reader in self._readers:
                reader.start()
        except RuntimeError:
            process.kill()
            process.wait()
            raise
        self._meter = Meter(process.pid)

    def poll(self) -> list[JobUpdate]:
        """What was heard since the last call. The last one is 'ended'."""
        if not self._ended:
            code = self._process.poll()
            if code is None:
                self._look()
            else:
                self._finish(code)
        heard, self._heard = self._heard, []
        return heard

    def _look(self) -> None:
        self._listen()
        if self._meter.look():
            self._update("measured", **self._measured())
        if self._asked_at is not None and time.monotonic() - self._asked_at > _LONGEST_STOP_S:
            kill(self._process.pid)

    def _finish(self, code: int) -> None:
        for reader in self._readers:
            reader.join(timeout=5)  # a process that the job has left behind may keep the pipe open
        self._listen()
        for pipe in (self._process.stdin, self._process.stdout, self._process.stderr):
            with contextlib.suppress(OSError):
                if pipe is not None:
                    pipe.close()
        measured = self._measured()
        self._peak_mb, self._cpu_seconds = measured["peak_mb"], measured["cpu_seconds"]
        if code == 0 and self._searching and self._asked_at is None:
            self._searching = False
            self._start()
            return
        if code == 0 and self._searching:
            code = 7  # asked to stop just when the cameras were found
        self._end(code, b"".join(self._words).decode("utf-8", "replace").strip(), measured)

    def _end(self, code: int, words: str, measured: dict[str, float]) -> None:
        self._ended = True
        seconds = time.monotonic() - self._began
        self._update("ended", code=code, error=self._error, words=words, seconds=seconds, **measured)

    def _measured(self) -> dict[str, float]:
        return {
            "peak_mb": max(self._peak_mb, self._meter.peak_mb),
            "cpu_seconds": self._cpu_seconds + self._meter.cpu_seconds,
        }

    def _listen(self) -> None:
        while not self._lines.empty():
            try:
                event = json.loads(self._lines.get())
            except ValueError:
                continue  # a stray line
            if isinstance(event, dict) and "event" in event:
                self._take(event)

    def _take(self, event: dict) -> None:
        if event["event"] == "error":
            self._error = {key: event.get(key) for key in ("name", "values", "code", "message", "hint")}
            return
        if event["event"] == "progress" and self.job.photos_alone:
            first, share = (0.0, _CAMERAS_SHARE) if self._searching else (_CAMERAS_SHARE, 1 - _CAMERAS_SHARE)
            event["fraction"] = first + share * event["fraction"]
            if self._searching:
                event["eta_s"] = None  # that of the search alone
        if event["event"] != "done":
            self._update("event", **event)

    def _update(self, kind: str, **content: object) -> None:
        self._heard.append(JobUpdate(self.job.name, kind, content))

    def stop(self) -> None:
        """Ask the job to write its checkpoint and to end."""
        if self._asked_at is None and not self._ended:
            self._asked_at = time.monotonic()
            with contextlib.suppress(OSError):
                if self._process.stdin is not None:
                    self._process.stdin.write(b'{"cmd": "stop"}\n')
                    self._process.stdin.flush()

    def kill(self) -> None:
        """End the process at once."""
        if not self._ended and self._process.poll() is None:
            kill(self._process.pid)
            self._process.wait()
