"""What this machine has, and what processes on it take."""

from __future__ import annotations

import contextlib
import os
import time
from pathlib import Path

import psutil

from blender_nep.stop_request import StopRequest

OUT_OF_JOB = "NEP_JOB_OUT"
"""The environment variable by which a process says that a batch has started it, and for which asset folder"""

_CONTAINER = Path("/sys/fs/cgroup")
"""The folder in which Linux says how much memory a container may have, and how much it has taken"""
_CONTAINER_FILES = (
    ("memory.max", "memory.current", "memory.stat", ("inactive_file", "active_file")),
    (
        "memory/memory.limit_in_bytes",
        "memory/memory.usage_in_bytes",
        "memory/memory.stat",
        ("total_inactive_file", "total_active_file"),
    ),
)
"""For cgroup version 2 and version 1: the files with the limit, with what is taken, and with its parts; and the names of
those parts that are copies of files. Linux gives their memory to processes that need it."""
_USABLE = 0.9
"""Share of the free memory that jobs may take"""
_LONGEST_WAIT_S = 120.0


def free_memory_mb() -> float:
    """The memory that jobs may take now [MB]: most of what is free on the machine, and in the container if there is one."""
    free = float(psutil.virtual_memory().available)
    for limit, taken, parts, file_copies in _CONTAINER_FILES:
        with contextlib.suppress(OSError, ValueError):  # it says "max" where there is no limit
            most, now = (float((_CONTAINER / file).read_text()) for file in (limit, taken))
            free = min(free, most - max(now - _sum_of(_CONTAINER / parts, file_copies), 0.0))
    return _USABLE * max(free, 0.0) / (1 << 20)


def _sum_of(parts: Path, names: tuple[str, ...]) -> float:
    """The sum [bytes] of the named lines of a file memory.stat; 0 if it cannot be read."""
    with contextlib.suppress(OSError, ValueError):
        sizes = dict(line.split() for line in parts.read_text().splitlines())
        return float(sum(int(sizes.get(name, 0)) for name in names))
    return 0.0


def usage(process: psutil.Process) -> tuple[float, float]:
    """(resident memory in MB, CPU seconds) of a process and all that it has started. (0, 0) if it has ended."""
    memory = seconds = 0.0
    with contextlib.suppress(psutil.Error):
        for one in (process, *process.children(recursive=True)):
            with contextlib.suppress(psutil.Error), one.oneshot():
                times = one.cpu_times()
                memory += one.memory_info().rss / (1 << 20)
                seconds += times.user + times.system
    return memory, seconds


def jobs_in(folder: Path) -> list[psutil.Process]:
    """The processes that a batch has started on this machine, for an asset in `folder` or in a folder below it.

    Jobs that somebody else has started there are not among them.
    """
    found = []
    for process in psutil.process_iter():
        if process.pid == os.getpid():
            continue
        with contextlib.suppress(psutil.Error, OSError, KeyError):  # the variables of other users are not readable
            out = Path(process.environ()[OUT_OF_JOB]).resolve()
            if folder.resolve() in (out, *out.parents):
                found.append(process)
    return found


def wait_for_end(processes: list[psutil.Process], stop: StopRequest | None = None) -> None:
    """Wait until all have ended, or until `stop`. After two minutes the rest is killed: the checkpoints are fresh."""
    until = time.monotonic() + _LONGEST_WAIT_S
    alive = processes
    while alive and time.monotonic() < until:
        if stop is not None and stop.requested:
            return
        _, alive = psutil.wait_procs(alive, timeout=0.2)
    for process in alive:
        with contextlib.suppress(psutil.Error):
            process.kill()
    psutil.wait_procs(alive, timeout=10)


def kill(pid: int) -> None:
    """End a process and all that it has started, at once."""
    with contextlib.suppress(psutil.Error):
        process = psutil.Process(pid)
        for one in (process, *process.children(recursive=True)):
            with contextlib.suppress(psutil.Error):
                one.kill()


class Meter:
    """Measures a running process at most once a second."""

    interval_s = 1.0

    def __init__(self, pid: int) -> None:
        self.peak_mb = self.cpu_seconds = 0.0
        self._process: psutil.Process | None = None
        with contextlib.suppress(psutil.Error):
            self._process = psutil.Process(pid)
        self._last = 0.0

    def look(self) -> bool:
        """Measure, if the last time was long enough ago. Returns whether it has measured."""
        if self._process is None or time.monotonic() - self._last < self.interval_s:
            return False
        self._last = time.monotonic()
        memory, seconds = usage(self._process)
        self.peak_mb = max(self.peak_mb, memory)
        self.cpu_seconds = max(self.cpu_seconds, seconds)
        return True
