"""The suite's JSON files as figures: one flat dict a run, and means over seeds and captures."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.suite.harness import read_row
from benchmarks.suite.runner import failure
from benchmarks.suite.step import STAGE_1
from blender_nep.job.stage_names import StageName


@dataclass
class Figure:
    """Mean of a figure over runs, and their standard deviation (0 for one run)."""

    mean: float
    deviation: float
    runs: int


def load(out: Path) -> list[dict]:
    """All rows of a suite's folder, sorted by name."""
    return [read_row(file) for file in sorted((out / "rows").glob("*.json"))]


def name_of(row: dict) -> tuple:
    """What tells a run from others."""
    return tuple(sorted((key, str(value)) for key, value in row["run"].items()))


def figures(row: dict, full: dict[tuple, dict]) -> dict[str, float]:
    """Scores and costs of a row. `full`: rows by `name_of`; what a run took over from another counts as its own."""
    learned = row["learn"]
    out = {
        key: value
        for step in ("score", "relight")
        for key, value in row.get(step, {}).items()
        if isinstance(value, int | float)
    }
    out |= {f"seconds_{stage}": learned["seconds"][stage] for stage in StageName}
    out |= {f"cpu_seconds_{stage}": seconds for stage, seconds in learned["stage_cpu_seconds"].items()}
    out |= {"seconds": learned["seconds_total"], "cpu_seconds": learned["cpu_seconds"], "peak_mb": learned["peak_mb"]}
    out |= {"views_of_run": learned["views"], "pixels_of_run": learned["pixels"] / learned["views"]}
    if "texture_rows" in out:
        out["texels"] = out.pop("texture_rows") ** 2
    if "stage_1_of" in learned:
        other = full.get(name_of({"run": row["run"] | {"ablation": "full"}}))
        if other is None:
            del out["cpu_seconds"]
        else:
            out["cpu_seconds"] += sum(other["learn"]["stage_cpu_seconds"].get(r, 0) for r in STAGE_1)
            out["peak_mb"] = max(out["peak_mb"], other["learn"]["peak_mb"])
    return {key: float(value) for key, value in out.items()}


class Results:
    """Runs that did not fail, with their figures."""

    def __init__(self, rows: Iterable[dict]) -> None:
        rows = list(rows)
        self.tried = [row["run"] for row in rows]
        """Runs that failed, too."""
        done = [row for row in rows if "learn" in row and "error" not in row["learn"]]
        full = {name_of(row): row for row in done}
        self.runs = [(row["run"], figures(row, full)) for row in done]

    def where(self, **conditions: object) -> Results:
        """The runs whose description has these values; a callable is asked."""
        chosen = Results([])

        def fits(run: dict) -> bool:
            return all(wanted(run[key]) if callable(wanted) else run[key] == wanted for key, wanted in conditions.items())

        chosen.tried = [run for run in self.tried if fits(run)]
        chosen.runs = [(run, values) for run, values in self.runs if fits(run)]
        return chosen

    def whole(self, **conditions: object) -> Results:
        """Runs on all photos, of the preset's size, on our own geometry."""
        return self.where(**{"views": None, "pixels": None, "geometry": "own"} | conditions)

    def values(self, key: str) -> list:
        """The values of a part of the description, in order of appearance."""
        return list(dict.fromkeys(run[key] for run, _ in self.runs))

    def figure(self, name: str) -> Figure | None:
        """Over all runs; None where no run has it."""
        found = [values[name] for _, values in self.runs if name in values]
        spread = float(np.std(found, ddof=1)) if len(found) > 1 else 0.0
        return Figure(float(np.mean(found)), spread, len(found)) if found else None

    def mean_of_captures(self, name: str, captures: Iterable[str]) -> Figure | None:
        """Mean over captures of the mean over seeds; its deviation is the root mean square of the seeds' deviations over
        the captures, divided by the root of their number. None unless every capture has it."""
        each = [self.where(capture=capture).figure(name) for capture in captures]
        if not each or None in each:
            return None
        return Figure(
            float(np.mean([f.mean for f in each])),
            float(np.sqrt(np.sum([f.deviation**2 for f in each])) / len(each)),
            sum(f.runs for f in each),
        )


def failures(rows: Iterable[dict]) -> list[tuple[dict, str]]:
    """What was run, and the message."""
    return [(row["run"], failure(row)) for row in rows if failure(row)]
