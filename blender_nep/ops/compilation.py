"""`kernel`: Numba's njit for kernels that are compiled once on a machine, whatever the number of processes.

Numba keeps on the disk what it compiles, but without a lock. Two processes that begin together compile the same kernel
twice, and one's index of the compiled signatures replaces the other's: the lost signature is compiled again by the next
process, or its entry names the machine code of another signature. So a process compiles while it holds a lock beside the
compiled files, and processes that wait for the lock read what was compiled.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from numba import njit
from numba.core.compiler_lock import global_compiler_lock

_LONGEST_WAIT_S = 300.0
"""A process that was stopped while it compiles must not stop all others. No kernel compiles for so long."""
_PAUSE_S = 0.02
_after_compiling: list[Callable[[Path], None]] = []


def kernel(**options: Any) -> Callable[[Callable], Any]:
    """A decorator: the function, compiled by `numba.njit(cache=True, **options)` once for all processes."""

    def decorate(function: Callable) -> Any:
        dispatcher = njit(cache=True, **options)(function)
        if dispatcher is function:  # NUMBA_DISABLE_JIT
            return function
        compile_or_load, folder = dispatcher.compile, dispatcher.stats.cache_path

        def compile_once(signature: Any) -> Any:
            """What Numba calls for a signature that this process has not called yet."""
            # Numba's lock of threads comes first: a thread that holds a file's lock never waits for another thread.
            with global_compiler_lock, _locked(Path(folder) / f"{function.__module__}.{function.__qualname__}.lock"):
                before = sum(dispatcher.stats.cache_misses.values())
                compiled = compile_or_load(signature)
            if sum(dispatcher.stats.cache_misses.values()) > before:
                for call in _after_compiling:
                    call(Path(folder))
            return compiled

        dispatcher.compile = compile_once
        return dispatcher

    return decorate


@contextmanager
def after_compiling(call: Callable[[Path], None]) -> Iterator[None]:
    """Within this context, call(folder) is called whenever this process has compiled a kernel that was not on the disk.

    `folder` is where the kernel is kept.
    """
    _after_compiling.append(call)
    try:
        yield
    finally:
        _after_compiling.remove(call)


@contextmanager
def held_alone(path: Path) -> Iterator[bool]:
    """Hold the lock of a file, if no other process holds it. Gives whether this process may go on: also without locks."""
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError:
        yield True
        return
    try:
        yield _lock(descriptor)
    finally:
        os.close(descriptor)  # gives the lock back


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Hold the lock of a file. After `_LONGEST_WAIT_S`, and where there are no locks, go on without it."""
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError:
        yield
        return
    try:
        until = time.monotonic() + _LONGEST_WAIT_S
        while not _lock(descriptor) and time.monotonic() < until:
            time.sleep(_PAUSE_S)
        yield
    finally:
        os.close(descriptor)  # gives the lock back


def _lock(descriptor: int) -> bool:
    """Try to lock an open file. True also where the file system knows no locks."""
    try:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        return False
    except OSError:
        return True
    return True
