"""Turns the end of a command into an exit code, and an error into one `error` event."""

from __future__ import annotations

import traceback
from collections.abc import Callable
from pathlib import Path

import torch

from blender_nep.errors import NepError, ObjectsFailed, Stopped
from blender_nep.job.reporting.events import Events

RESUMABLE = "Work since the last checkpoint is lost; --resume goes on from there."
"""The hint after a second Ctrl-C, for a command that has checkpoints."""


def exit_code(work: Callable[[], None], events: Events, asset: Path, interrupted_hint: str = RESUMABLE) -> int:
    """Do `work` and return the exit code. The traceback of an error goes to the log; `asset` is the folder of the log.

    A stop, and the failed objects of a batch, have no traceback: they are no fault of the program. interrupted_hint says
    what to do after a second Ctrl-C.
    """
    try:
        work()
        return 0
    except NepError as error:
        if not isinstance(error, Stopped | ObjectsFailed):
            events.log_traceback(error)
        events.error(error)
        return error.code
    except KeyboardInterrupt:
        interrupted = Stopped("interrupted", interrupted_hint, "stopped.interrupted")
        events.error(interrupted)
        return interrupted.code
    except Exception as error:  # a bug, or no memory
        events.log_traceback(error)
        where = f"The details are in {asset / 'log.txt'}."
        if not events.has_log:
            where = "".join(traceback.format_exception(error))
        told = unexpected(error, where)
        events.error(told)
        return told.code
    finally:
        events.close()


def unexpected(error: Exception, where: str) -> NepError:
    """The error for an exception that nobody foresaw, for a user. `where` is a sentence that says where the traceback is."""
    if isinstance(error, MemoryError | torch.OutOfMemoryError) or "allocate memory" in str(error):
        return NepError("out of memory", f"Try --preset preview, or smaller photos. {where}", "unexpected.no_memory")
    text = " ".join(str(error).split())
    return NepError(f"unexpected {type(error).__name__}: {text[:200]}", where)
