"""How long a job takes on this machine: measured on the last jobs of each preset, before the first of them a guess."""

import json
import os
import statistics
from pathlib import Path

GUESS_S = {"preview": 90.0, "balanced": 270.0, "quality": 720.0}  # 60 photos of 400 x 400 on two CPU cores
REMEMBERED = 5


def expected_seconds(file: Path, preset: str) -> tuple[float, bool]:
    """(seconds, whether they were measured here) of a whole job with this preset."""
    measured = _read(file).get(preset)
    return (statistics.median(measured), True) if measured else (GUESS_S[preset], False)


def remember(file: Path, asset: Path) -> None:
    """Add the time that a finished asset tells of. An asset without one, or a file that cannot be written, is let be."""
    try:
        report = json.loads((Path(asset) / "report.json").read_text(encoding="utf-8"))
        preset, seconds = report["preset"], float(report["seconds_total"])
    except (OSError, ValueError, KeyError, TypeError):
        return
    if preset not in GUESS_S or not seconds > 0:
        return
    known = _read(file)
    known[preset] = [*known.get(preset, []), seconds][-REMEMBERED:]
    partial = Path(file).with_suffix(".partial")
    try:
        partial.parent.mkdir(parents=True, exist_ok=True)
        partial.write_text(json.dumps(known), encoding="utf-8")
        os.replace(partial, file)
    except OSError:
        partial.unlink(missing_ok=True)


def _read(file: Path) -> dict[str, list[float]]:
    try:
        found = json.loads(Path(file).read_text(encoding="utf-8"))
        return {preset: [float(seconds) for seconds in found[preset]] for preset in GUESS_S if preset in found}
    except (OSError, ValueError, TypeError):
        return {}
