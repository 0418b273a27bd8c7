"""Judges how a job has ended: whether it is tried again, and what is said about it."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Any

from blender_nep.errors import NepError
from blender_nep.safety.plain_files import read_json

NOT_STARTED = "unexpected.job_not_started"
"""Name of the error if the system could not start the process of a job"""
_NO_MEMORY = "unexpected.no_memory"
_OTHER_RUN = ("usage.other_run", "usage.other_version")


def is_crash(code: int | None, error: dict | None) -> bool:
    """Whether a job might end well if it is tried again: it was killed, it crashed, or memory or processes were short.

    A job that has said why it failed would say the same again: the capture, the seed and the disk are the same.
    """
    if code is None or code < 0 or error is None:
        return True
    return error["name"] in (_NO_MEMORY, NOT_STARTED) or error["name"].startswith("stopped")


def lacked_memory(code: int | None, error: dict | None) -> bool:
    """Whether the job may have ended because memory was short: the system ends processes by SIGKILL then."""
    return code == -9 or (error is not None and error["name"] == _NO_MEMORY)


def refused_checkpoints(error: dict | None) -> bool:
    """Whether the job was refused because the checkpoints in its folder are of another run of ours.

    They are so when the capture was corrected after an earlier attempt.
    """
    return error is not None and error["name"] in _OTHER_RUN


def failure(code: int | None, error: dict | None, words: str) -> dict[str, Any]:
    """The error of a job, in its own words if it has said any."""
    if error is not None:
        return error
    hint = f"Its last words: {words}" if words else "Its log.txt may say more."
    if code is None:
        said = NepError("the computer that ran the job was lost", "Start the batch again.", "unexpected.computer_lost")
    elif code < 0:
        names = {one.value: one.name for one in signal.Signals}
        name = names.get(-code, str(-code))
        if code == -9:
            hint = "If memory was short, try fewer --workers, a smaller --memory, or --preset preview."
        said = NepError(f"the job was ended by {name}", hint, "unexpected.job_killed", signal=name)
    else:
        said = NepError(f"the job ended with exit code {code}", hint, "unexpected.job_crashed", exit_code=code)
    return said.to_dict()


def read_report(asset: Path) -> dict[str, Any] | None:
    """The asset's report.json; None if the asset is not complete."""
    try:
        content = read_json(asset / "report.json")
    except (OSError, ValueError):
        return None
    return content if isinstance(content, dict) else None
