"""What the benchmarks share: steps in processes of their own, rows as JSON files, Markdown tables."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

_POLL = 0.2
"""Seconds between two looks at a running step."""


@dataclass
class Ended:
    """How a process ended, and what it alone has used."""

    code: int
    """Exit code, or minus a signal's number."""
    seconds: float
    cpu_seconds: float
    peak_mb: float
    """Linux counts the memory of the process that started it, too: the runner stays small."""
    timed_out: bool


class Children:
    """The steps that are running. Once `stopped` is set all of them are killed."""

    stopped = False

    def run(self, command: Sequence[str], log: Path, threads: int, limit: float) -> Ended:
        """Run a command to its end, or kill it with its children after `limit` seconds. Output goes to `log`."""
        named = {f"{library}_NUM_THREADS": str(threads) for library in ("OMP", "NUMBA", "OPENBLAS", "MKL")}
        start = time.perf_counter()
        with open(log, "ab") as output:
            # its standard input closes when this process dies, however it does; a job stops at that
            child = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=output, stderr=output, env=os.environ | named,
                                     start_new_session=True)
            timed_out = False
            while True:
                pid, status, usage = os.wait4(child.pid, os.WNOHANG)
                if pid:
                    break
                if not timed_out and (self.stopped or time.perf_counter() - start > limit):
                    timed_out = not self.stopped
                    os.killpg(child.pid, signal.SIGKILL)
                time.sleep(_POLL)
        child.returncode = os.waitstatus_to_exitcode(status)
        child.stdin.close()
        peak = usage.ru_maxrss / (1 << 20 if sys.platform == "darwin" else 1 << 10)
        return Ended(child.returncode, time.perf_counter() - start, usage.ru_utime + usage.ru_stime, peak, timed_out)


def write_row(file: Path, row: dict) -> None:
    """As JSON, whole or not at all."""
    file.parent.mkdir(parents=True, exist_ok=True)
    part = file.with_suffix(".part")
    part.write_text(json.dumps(row, indent=1), encoding="utf-8")
    part.replace(file)


def read_row(file: Path) -> dict:
    """What a file of `write_row` holds; {} where there is none."""
    return json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}


def markdown(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A table; numbers with four digits."""
    lines = ["| " + " | ".join(header) + " |", "|---" * len(header) + "|"]
    lines += ["| " + " | ".join(f"{c:.4g}" if isinstance(c, float) else str(c) for c in row) + " |" for row in rows]
    return "\n".join(lines)
