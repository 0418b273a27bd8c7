"""Puts the frames of a video into the capture that is written."""

from __future__ import annotations

import itertools
import os
import shutil
from pathlib import Path

from blender_nep.files import output_errors

FOLDER = "images"
"""The folder of the frames in the capture"""


def keep_frames(frames: Path, capture: Path) -> Path:
    """Copy the folder `frames` into the folder `capture`, under a name that is free, and return its new path.

    The name is `images`, or `images2` and so on where there is something already: nothing is replaced. The copy gets its
    name at its end. Raises OutputError.
    """
    temporary = capture / f".{FOLDER}.{os.getpid()}.tmp"
    with output_errors(capture):
        capture.mkdir(parents=True, exist_ok=True)
        shutil.rmtree(temporary, ignore_errors=True)
        try:
            shutil.copytree(frames, temporary)
            names = (f"{FOLDER}{number or ''}" for number in itertools.chain([0], itertools.count(2)))
            kept = next(capture / name for name in names if not os.path.lexists(capture / name))
            os.rename(temporary, kept)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)
    return kept
