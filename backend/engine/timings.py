"""Tells how long a job takes: from the last jobs on this computer, or by a first guess where no job has ended yet."""

import json
import math
import os
import statistics
from pathlib import Path
from typing import NamedTuple

from ..plain_files import read_json

EXPECTED_SECONDS = {"preview": 94.0, "balanced": 288.0, "quality": 870.0}
"""Seconds that a whole job takes with each preset: 60 photos of 400 x 400 on two cores.

Each number is the sum of `fields_seconds`, `surface_seconds` and `material_seconds` in blender_nep/presets/preset.py. The
sums are copied here, because Blender's Python does not import the library. A test compares both files.
"""
JOBS_REMEMBERED = 5  # for each preset
THESE_PHOTOS, THIS_COMPUTER, GUESS = "these photos", "this computer", "guess"


class Expected(NamedTuple):
    """How long a whole job is likely to take.

    `basis`: THESE_PHOTOS where jobs with these photos were measured, THIS_COMPUTER where jobs with other photos were
    measured on this computer, GUESS where none were.
    """

    seconds: float
    basis: str


class _Job(NamedTuple):
    """A job that has ended: its capture folder, its photos, the seconds that it took to read them, and all other seconds."""

    capture: str
    photos: int
    reading: float
    rest: float


def expected_seconds(file: Path, preset: str, capture: Path | None = None, photos: int = 0) -> Expected:
    """The time that a job of `photos` photos in the folder `capture` is likely to take with this preset.

    It is the median of the last jobs with these photos. Where there was none, it is that of the last jobs with other photos,
    whose time of reading is scaled by the number of photos; the other steps take as long for few photos as for many.
    `file` is the file that `remember` writes.
    """
    jobs = _read(file).get(preset, [])
    same = [job for job in jobs if capture is not None and job.capture == _key(capture)]
    if same:
        return Expected(statistics.median(job.reading + job.rest for job in same), THESE_PHOTOS)
    if jobs:
        seconds = statistics.median(job.reading * (photos / job.photos if photos else 1) + job.rest for job in jobs)
        return Expected(seconds, THIS_COMPUTER)
    return Expected(EXPECTED_SECONDS[preset], GUESS)


def remember(file: Path, asset: Path) -> None:
    """Add to `file` the seconds that the report of the finished `asset` gives.

    The function does nothing where there is no such report, or where `file` cannot be written.
    """
    try:
        report = read_json(Path(asset) / "report.json")
        preset, capture = report["preset"], report["capture"]
        reading = float(report["seconds"]["capture"])
        job = _job([_key(capture["folder"]), capture["views"], reading, float(report["seconds_total"]) - reading])
    except (OSError, ValueError, KeyError, TypeError, OverflowError):
        return
    if preset not in EXPECTED_SECONDS:
        return
    known = _read(file)
    known[preset] = [*known.get(preset, []), job][-JOBS_REMEMBERED:]
    partial = Path(file).with_suffix(".partial")
    try:
        partial.parent.mkdir(parents=True, exist_ok=True)
        partial.write_text(json.dumps(known), encoding="utf-8")
        os.replace(partial, file)
    except OSError:
        partial.unlink(missing_ok=True)


def _job(values: list) -> _Job:
    """The job that these values describe. ValueError or TypeError where they describe none."""
    job = _Job(str(values[0]), int(values[1]), float(values[2]), float(values[3]))
    if not (job.photos > 0 and 0 <= job.reading < math.inf and 0 < job.rest < math.inf):
        raise ValueError("no such job")
    return job


def _key(folder: Path | str) -> str:
    """One string for all ways to write the path of the same folder."""
    return os.path.normcase(os.path.abspath(folder))


def _read(file: Path) -> dict[str, list[_Job]]:
    try:
        found = read_json(Path(file))
        return {preset: [_job(values) for values in found[preset]] for preset in EXPECTED_SECONDS if preset in found}
    except (OSError, ValueError, TypeError, KeyError, IndexError, OverflowError):
        return {}
