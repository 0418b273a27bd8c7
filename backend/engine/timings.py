"""Tells how long a job takes: the median of the last jobs on this computer, or a first guess where no job has ended yet."""

import json
import math
import os
import statistics
from pathlib import Path

from ..plain_files import read_json

EXPECTED_SECONDS = {"preview": 94.0, "balanced": 288.0, "quality": 870.0}
"""Seconds that a whole job takes with each preset: 60 photos of 400 x 400 on two cores.

Each number is the sum of `fields_seconds`, `surface_seconds` and `material_seconds` in blender_nep/presets/preset.py. The
sums are copied here, because Blender's Python does not import the library. A test compares both files.
"""
JOBS_REMEMBERED = 5  # for each preset


def expected_seconds(file: Path, preset: str) -> tuple[float, bool]:
    """(seconds of a whole job with this preset, True where they were measured on this computer).

    `file` is the file that `remember` writes.
    """
    measured = _read(file).get(preset)
    return (statistics.median(measured), True) if measured else (EXPECTED_SECONDS[preset], False)


def remember(file: Path, asset: Path) -> None:
    """Add to `file` the seconds that the report of the finished `asset` gives.

    The function does nothing where there is no such report, or where `file` cannot be written.
    """
    try:
        report = read_json(Path(asset) / "report.json")
        preset, seconds = report["preset"], float(report["seconds_total"])
    except (OSError, ValueError, KeyError, TypeError, OverflowError):
        return
    if preset not in EXPECTED_SECONDS or not 0 < seconds < math.inf:
        return
    known = _read(file)
    known[preset] = [*known.get(preset, []), seconds][-JOBS_REMEMBERED:]
    partial = Path(file).with_suffix(".partial")
    try:
        partial.parent.mkdir(parents=True, exist_ok=True)
        partial.write_text(json.dumps(known), encoding="utf-8")
        os.replace(partial, file)
    except OSError:
        partial.unlink(missing_ok=True)


def _read(file: Path) -> dict[str, list[float]]:
    try:
        found = read_json(Path(file))
        return {preset: [float(seconds) for seconds in found[preset]] for preset in EXPECTED_SECONDS if preset in found}
    except (OSError, ValueError, TypeError, OverflowError):
        return {}
