"""Figures of kept rows: a flat dict for each run, and means over seeds and captures."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.suite.kept_rows import run_of

PARTS = ("scores", "seconds", "size")
"""The parts of a kept row that hold figures."""


@dataclass
class Figure:
    """The mean of a figure over `runs` runs, and its standard deviation (0 for one run)."""

    mean: float
    deviation: float
    runs: int


@dataclass
class Values:
    """The figures of one kept row: means of `runs` seeds, and their deviations (none for one seed)."""

    means: dict[str, float]
    deviations: dict[str, float]
    runs: int


def values_of(row: dict) -> Values:
    """The figures of a kept row: its scores, seconds and sizes."""
    means = {key: float(value) for part in PARTS for key, value in row.get(part, {}).items()}
    return Values(means, row.get("deviations", {}), row.get("seeds", 1))


def pooled(parts: Sequence[tuple[float, float, int]]) -> Figure:
    """The figure of all runs, where each of `parts` has (mean, deviation, number) of some of them."""
    runs = sum(number for _, _, number in parts)
    mean = sum(own * number for own, _, number in parts) / runs
    squares = sum((number - 1) * spread**2 + number * (own - mean) ** 2 for own, spread, number in parts)
    return Figure(mean, math.sqrt(squares / (runs - 1)) if runs > 1 else 0.0, runs)


class Results:
    """The runs whose learning did not fail, with their figures. `runs` is [(the run's fields, its figures)]."""

    def __init__(self, rows: Iterable[dict]) -> None:
        rows = list(rows)
        self.tried = [run_of(row) for row in rows]
        """The fields of all runs, those that failed too."""
        self.runs = [(run_of(row), values_of(row)) for row in rows if not row.get("error", "").startswith("learn:")]

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

    @property
    def count(self) -> int:
        """How many runs there are. A row of means of several seeds counts as that many."""
        return sum(values.runs for _, values in self.runs)

    def figure(self, name: str) -> Figure | None:
        """The mean of a figure over all runs that have it; None where no run has it."""
        found = [
            (values.means[name], values.deviations.get(name, 0.0), values.runs)
            for _, values in self.runs
            if name in values.means
        ]
        return pooled(found) if found else None

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
    return [(run_of(row), row["error"]) for row in rows if "error" in row]
