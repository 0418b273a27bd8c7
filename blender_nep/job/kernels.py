"""Compiles the kernels beside a job that finds none on the disk (`ops.rehearsal`).

That is the first job after an installation that has not compiled them, or after an update. A job compiles a kernel when it
needs it, and waits meanwhile. As soon as it has compiled one, processes on other cores compile those that it needs later.
"""

from __future__ import annotations

import contextlib
import subprocess
from collections.abc import Iterator
from pathlib import Path

from blender_nep.ops.compilation import after_compiling, held_alone
from blender_nep.safety.isolated_python import NEUTRAL_FOLDER, isolated_python

_MOST = 3
"""Most processes beside a job. The slowest kernels take a tenth of all seconds, so that more would gain little."""


@contextlib.contextmanager
def compiled_beside(threads: int) -> Iterator[None]:
    """Within this context, up to `threads` - 1 other processes compile kernels once the job has had to compile one.

    Those that still run at the end of the context are ended; what they have compiled stays. On a machine, they help one job
    at a time. A process that cannot be started is no error: then the job compiles all kernels itself.
    """
    count = min(threads - 1, _MOST)
    with contextlib.ExitStack() as ends:
        begun = False

        def begin(folder: Path) -> None:
            nonlocal begun
            if not begun and ends.enter_context(held_alone(folder / "rehearsal.lock")):
                for part in range(count):
                    ends.callback(_end, _started(part, count))
            begun = True

        with after_compiling(begin) if count > 0 else contextlib.nullcontext():
            yield


def _started(part: int, parts: int) -> subprocess.Popen | None:
    with contextlib.suppress(OSError):
        return subprocess.Popen(
            [*isolated_python(), "-m", "blender_nep.ops.rehearsal", str(part), str(parts)],
            cwd=NEUTRAL_FOLDER,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
        )
    return None


def _end(process: subprocess.Popen | None) -> None:
    if process is not None:
        process.terminate()
        process.wait()
