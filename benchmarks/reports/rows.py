"""Reads figures from the suite's JSON files: a flat dict for each run, and means over seeds and captures."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.row_files import read_row
from benchmarks.suite.runner import failure
from benchmarks.suite.step import STAGE_1
from blender_nep.job.stage_names import StageName


@dataclass
class Figure:
    """The mean of a figure over `runs` runs, and its standard deviation (0 for one run)."""

    mean: float
    deviation: float
    runs: int


def load(out: Path) -> list[dict]:
    """All rows of a suite's folder, sorted by the names of their files."""
    return [read_row(file) for file in sorted((out / "rows").glob("*.json"))]


def name_of(row: dict) -> tuple:
    """A key that differs from run to run: the sorted fields of the run and their values."""
    return tuple(sorted((key, str(value)) for key, value in row["run"].items()))


def figures(row: dict, full: dict[tuple, dict]) -> dict[str, float]:
    """The scores and costs of a row.

    `full` holds rows by their `name_of`. Where a run has taken over the stage 1 of another run, the costs of that stage 1
    count as its own.
    """
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
    """The runs that did not fail, with their figures. `runs` is [(the run's fields, its figures)]."""

    def __init__(self, rows: Iterable[dict]) -> None:
        rows = list(rows)
        self.tried = [row["run"] for row in rows]
        """The fields of all runs, those that failed too."""
        done = [row for row in rows if "learn" in row and "error" not in row["learn"]]
        full = {name_of(row): row for row in done}
        self.runs = [(row["run"], figures(row, full)) for row in done]

    def where(self, **conditions: object) -> Results:
        """The runs whose fields meet the conditions.

        A condition is a value that the field must have, or a function that returns True for the field's value.
        """
        chosen = Results([])

        def fits(run: dict) -> bool:
            return all(wanted(run[key]) if callable(wanted) else run[key] == wanted for key, wanted in conditions.items())

        chosen.tried = [run for run in self.tried if fits(run)]
        chosen.runs = [(run, values) for run, values in self.runs if fits(run)]
        return chosen

    def whole(self, **conditions: object) -> Results:
        """The runs that learn from all photos, with the preset's number of pixels, on their own mesh.

        They must meet the `conditions` too, which override these three.
        """
        return self.where(**{"views": None, "pixels": None, "geometry": "own"} | conditions)

    def values(self, key: str) -> list:
        """The different values that a field of the runs has, in the order of the runs."""
        return list(dict.fromkeys(run[key] for run, _ in self.runs))

    def figure(self, name: str) -> Figure | None:
        """The mean of a figure over all runs that have it; None where no run has it."""
        found = [values[name] for _, values in self.runs if name in values]
        spread = float(np.std(found, ddof=1)) if len(found) > 1 else 0.0
        return Figure(float(np.mean(found)), spread, len(found)) if found else None

    def mean_of_captures(self, name: str, captures: Iterable[str]) -> Figure | None:
        """The mean over captures of the means over seeds; None where a capture does not have the figure.

        Its deviation is the root mean square of the seeds' deviations over the captures, divided by the root of the number
        of captures.
        """
        each = [self.where(capture=capture).figure(name) for capture in captures]
        if not each or None in each:
            return None
        return Figure(
            float(np.mean([f.mean for f in each])),
            float(np.sqrt(np.sum([f.deviation**2 for f in each])) / len(each)),
            sum(f.runs for f in each),
        )


def failures(rows: Iterable[dict]) -> list[tuple[dict, str]]:
    """(the run's fields, its message) of each run that failed."""
    return [(row["run"], failure(row)) for row in rows if failure(row)]
