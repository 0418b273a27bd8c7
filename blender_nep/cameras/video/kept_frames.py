"""Puts the frames of a video into the capture that is written, and finds them there again."""

from __future__ import annotations

import itertools
import os
import re
import shutil
from pathlib import Path, PurePosixPath

from blender_nep.capture.formats import transforms
from blender_nep.files import output_errors
from blender_nep.safety.plain_files import read_json

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


def frames_folder(capture: Path) -> Path:
    """The folder of the frames in the folder `capture`: `images`, or `images2` and so on, where its transforms.json says so.

    It says so if it names photos of that folder alone, and if the folder is there.
    """
    try:
        frames = read_json(capture / transforms.FILE)["frames"]
        named = {PurePosixPath(frame["file_path"]).parent.as_posix() for frame in frames}
    except (OSError, ValueError, KeyError, TypeError):  # no transforms.json, or none of the usual form
        return capture / FOLDER
    name = named.pop() if len(named) == 1 else FOLDER
    return capture / (name if re.fullmatch(rf"{FOLDER}\d*", name) and (capture / name).is_dir() else FOLDER)
