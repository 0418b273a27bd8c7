"""What the benchmarks share: presets with fields changed, steps in processes of their own, resumable rows, Markdown tables.

Light on purpose: the suite's runner, which is counted into the memory of what it starts, imports no more than this.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from blender_nep.errors import NepError, Stopped
from blender_nep.presets import Preset

_POLL = 0.2
"""Seconds between two looks at a running step."""


def with_changes(preset: Preset, changes: dict[str, dict]) -> Preset:
    """The preset with some fields of its parts changed, or of its own ("preset"): {"material": {"levels": 1}}."""
    parts = {part: replace(getattr(preset, part), **values) for part, values in changes.items() if part != "preset"}
    return replace(preset, **changes.get("preset", {}), **parts)


def use_threads(count: int) -> None:
    """For torch and Numba."""
    import numba
    import torch

    torch.set_num_threads(count)
    numba.set_num_threads(min(count, numba.config.NUMBA_NUM_THREADS))


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
            child = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=output, stderr=output, env=os.environ | named, start_new_session=True
            )
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


def resumed(file: Path, row: dict, run: Callable[[], dict]) -> dict:
    """What `file` holds; where there is none, `row` with what run() gives or its error's message, written there. Who is
    stopped leaves no row."""
    if not file.is_file():
        try:
            row = row | run()
        except Stopped:
            raise
        except NepError as error:
            row = row | {"error": str(error)}
        except Exception as error:  # a campaign of hours must not end with one run, whatever that ran into
            traceback.print_exc()
            row = row | {"error": f"{type(error).__name__}: {error}"}
        write_row(file, row)
    return read_row(file)


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
