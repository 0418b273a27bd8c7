"""What this machine has, and what processes on it take."""

from __future__ import annotations

import contextlib
import os
import time
from pathlib import Path

import psutil

_LIMIT, _TAKEN = Path("/sys/fs/cgroup/memory.max"), Path("/sys/fs/cgroup/memory.current")
"""Files by which Linux says how much memory a container may have, and how much it has taken"""
_USABLE = 0.9
"""Share of the free memory that jobs may take"""
_LONGEST_WAIT_S = 120.0


def free_memory_mb() -> float:
    """The memory that jobs may take now [MB]: most of what is free on the machine, and in the container if there is one."""
    free = float(psutil.virtual_memory().available)
    with contextlib.suppress(OSError, ValueError):  # it says "max" where there is no limit
        free = min(free, float(_LIMIT.read_text()) - float(_TAKEN.read_text()))
    return _USABLE * max(free, 0.0) / (1 << 20)


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
    """The processes of this machine that write an asset or cameras into `folder`, or into a folder below it."""
    found = []
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error, ValueError, IndexError):
            command = process.cmdline()
            if process.pid == os.getpid() or not {"reconstruct", "cameras"} & set(command):
                continue
            out = Path(process.cwd(), command[command.index("--out") + 1])
            if folder.resolve() in (out.resolve(), *out.resolve().parents):
                found.append(process)
    return found


def wait_for_end(processes: list[psutil.Process]) -> None:
    """Wait until all have ended. Those that are there after two minutes are killed: their checkpoints are fresh."""
    _, alive = psutil.wait_procs(processes, timeout=_LONGEST_WAIT_S)
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
