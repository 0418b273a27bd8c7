"""What the benchmarks share: changed presets, steps in separate processes, rows that are resumed, Markdown tables.

This file imports little. The suite's runner imports no more than this file, because Linux counts the runner's own memory
into the peak memory of the processes that it starts.
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
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path

from benchmarks.row_files import read_row, write_row
from blender_nep.errors import NepError, Stopped
from blender_nep.files import write_text
from blender_nep.presets import Preset
from blender_nep.safety.isolated_python import NEUTRAL_FOLDER, isolated_python

_POLL = 0.2
"""Seconds between two checks whether a running step has ended."""


ROOT = Path(__file__).resolve().parents[2]
"""The folder of the checkout. The benchmarks are not installed, so a Python that runs one must be told where they are."""


def command_of(module: str, *arguments: object) -> list[str]:
    """The command that runs a module of the benchmarks in a Python of its own, which imports nothing of its current folder.

    Paths among the arguments are absolute: `Children` runs a command in a neutral folder.
    """
    start = f"import runpy, sys; sys.path.insert(0, {str(ROOT)!r}); runpy.run_module({module!r}, run_name='__main__')"
    return [*isolated_python(), "-c", start, *map(str, arguments)]


def with_changes(preset: Preset, changes: dict[str, dict]) -> Preset:
    """The preset with some fields changed, for example by {"material": {"levels": 1}}.

    A key of `changes` is the name of a part of the preset, or "preset" for the preset's own fields.
    """
    parts = {part: replace(getattr(preset, part), **values) for part, values in changes.items() if part != "preset"}
    return replace(preset, **changes.get("preset", {}), **parts)


def use_threads(count: int) -> None:
    """Let torch and Numba use `count` threads."""
    import numba
    import torch

    torch.set_num_threads(count)
    numba.set_num_threads(min(count, numba.config.NUMBA_NUM_THREADS))


@dataclass
class Ended:
    """How a process ended, and the time and memory that it used."""

    code: int
    """Exit code, or minus a signal's number."""
    seconds: float
    cpu_seconds: float
    peak_mb: float
    """Linux counts the memory of the process that started this one, too. Therefore the suite's runner must stay small."""
    timed_out: bool


class Children:
    """Runs steps as processes. When `stopped` is set, all running processes are killed."""

    stopped = False

    def run(self, command: Sequence[str], log: Path, threads: int, limit: float) -> Ended:
        """Run a command to its end. After `limit` seconds it is killed, together with its own children.

        The command has a neutral current folder. What it prints is added to the file `log`. Its libraries use `threads`
        threads. Where this call is interrupted, for example by Ctrl-C, the command is killed together with its children, and
        the interrupt goes on.
        """
        named = {f"{library}_NUM_THREADS": str(threads) for library in ("OMP", "NUMBA", "OPENBLAS", "MKL")}
        start = time.perf_counter()
        with open(log, "ab") as output:
            # The child's standard input closes when this process ends, for any reason. A job stops when that happens.
            child = subprocess.Popen(
                command,
                cwd=NEUTRAL_FOLDER,
                stdin=subprocess.PIPE,
                stdout=output,
                stderr=output,
                env=os.environ | named,
                start_new_session=True,
            )
            timed_out = False
            try:
                while True:
                    pid, status, usage = os.wait4(child.pid, os.WNOHANG)
                    if pid:
                        break
                    if not timed_out and (self.stopped or time.perf_counter() - start > limit):
                        timed_out = not self.stopped
                        os.killpg(child.pid, signal.SIGKILL)
                    time.sleep(_POLL)
            except BaseException:  # the child has a session of its own, so the terminal's Ctrl-C does not reach it
                with suppress(ProcessLookupError):
                    os.killpg(child.pid, signal.SIGKILL)
                child.wait()
                raise
        child.returncode = os.waitstatus_to_exitcode(status)
        child.stdin.close()
        peak = usage.ru_maxrss / (1 << 20 if sys.platform == "darwin" else 1 << 10)
        return Ended(child.returncode, time.perf_counter() - start, usage.ru_utime + usage.ru_stime, peak, timed_out)


def resumed(file: Path, row: dict, run: Callable[[], dict]) -> dict:
    """The row that `file` holds. Where there is no file, call run(), and write the row into the file first.

    `row` says what is measured. A file that holds a row of something else, such as other photos, is refused by SystemExit.
    What is written is `row` with the values that run() returns, or with "error" and the message of the error that it raises,
    and with the commit and the date of the run. A run that was stopped writes no row, and raises Stopped.
    """
    asked = json.loads(json.dumps(row))
    if not file.is_file():
        commit = commit_now()  # before the run, because the code may change while it runs
        try:
            row = row | run()
        except Stopped:
            raise
        except NepError as error:
            row = row | {"error": str(error)}
        except Exception as error:  # one run that fails, for any reason, must not end a campaign of hours
            traceback.print_exc()
            row = row | {"error": f"{type(error).__name__}: {error}"}
        write_row(file, row | {"commit": commit, "date": datetime.now().date().isoformat()})
    held = read_row(file)
    if other := sorted(key for key, value in asked.items() if held.get(key) != value):
        raise SystemExit(f"{file} holds a row of something else ({', '.join(other)}): use another --out, or remove it")
    return held


def commit_now() -> str:
    """The commit of this code, with 8 digits and "-dirty" where files differ from it; empty where git does not know it."""
    git = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty", "--abbrev=8", "--exclude=*"]
    return subprocess.run(git, cwd=NEUTRAL_FOLDER, capture_output=True, text=True, check=False).stdout.strip()


MADE_FROM = "made_from.txt"
"""File in the folder of a capture that was made from another one. It holds what tells the source."""


def is_made_from(folder: Path, source: str) -> bool:
    """Whether the capture in `folder` is complete and was made from what the text `source` tells."""
    file = folder / MADE_FROM
    return (folder / "transforms.json").is_file() and file.is_file() and file.read_text(encoding="utf-8") == source


def write_made(folder: Path, transforms: dict, source: str) -> None:
    """Write what completes a capture that was made from another one: transforms.json, and last what the text `source` tells.

    Each file is written under a temporary name and then renamed.
    """
    (folder / MADE_FROM).unlink(missing_ok=True)  # an older one does not tell the source of the new transforms.json
    write_text(folder / "transforms.json", json.dumps(transforms, indent=1))
    write_text(folder / MADE_FROM, source)


def link(place: Path, target: Path) -> None:
    """Make `place` a symbolic link to `target`. A link that is there is replaced at once, and a file stays as it is."""
    if place.exists() and not place.is_symlink():
        return
    part = place.with_name(f"{place.name}.{os.getpid()}.part")
    part.unlink(missing_ok=True)
    part.symlink_to(target.resolve())
    part.replace(place)


def markdown(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A Markdown table. Floating-point numbers have four significant digits.

    A line break in a cell becomes a space, and a `|` is escaped, so that a message of an error stays in its cell.
    """
    lines = ["| " + " | ".join(map(_cell, header)) + " |", "|---" * len(header) + "|"]
    lines += ["| " + " | ".join(map(_cell, row)) + " |" for row in rows]
    return "\n".join(lines)


def _cell(value: object) -> str:
    text = f"{value:.4g}" if isinstance(value, float) else str(value)
    return " ".join(text.splitlines()).replace("|", "\\|")
