"""Standard input, output and errors that are closed, or that nobody reads."""

from __future__ import annotations

import contextlib
import ctypes
import os
import sys
from collections.abc import Iterator


def open_closed_streams() -> None:
    """Put an empty file in the place of each standard stream that is closed.

    Python has no `sys.stdout` then, and the next file that is opened gets the stream's number: C libraries would print into
    that file.
    """
    for descriptor, name, mode in ((0, "stdin", "r"), (1, "stdout", "w"), (2, "stderr", "w")):
        try:
            os.fstat(descriptor)
        except OSError:
            empty = os.open(os.devnull, os.O_RDWR)
            if empty != descriptor:
                os.dup2(empty, descriptor)
                os.close(empty)
            setattr(sys, name, open(descriptor, mode, encoding="utf-8", errors="backslashreplace", closefd=False))


@contextlib.contextmanager
def prints_go_to_errors() -> Iterator[None]:
    """Send what libraries print on standard output to standard errors meanwhile, where it cannot spoil a result."""
    sys.stdout.flush()
    kept = os.dup(1)
    os.dup2(2, 1)  # C and C++ libraries write to the descriptor
    try:
        with contextlib.redirect_stdout(sys.stderr):
            yield
    finally:
        with contextlib.suppress(OSError, AttributeError, TypeError):  # Windows has no such name for the C library
            ctypes.CDLL(None).fflush(None)  # what C libraries print to a pipe waits in a buffer
        os.dup2(kept, 1)
        os.close(kept)


def tell(*lines: str) -> OSError | None:
    """Print lines on standard output. Returns the error where that cannot be written, None also where nobody reads it."""
    try:
        print(*lines, sep="\n", flush=True)
        return None
    except OSError as error:
        empty = os.open(os.devnull, os.O_WRONLY)
        os.dup2(empty, 1)  # Python tries to write the rest when it ends
        os.close(empty)
        return None if isinstance(error, BrokenPipeError) else error
