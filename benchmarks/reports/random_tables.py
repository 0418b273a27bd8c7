"""Makes the Markdown tables of `docs/random-scenes.md`: the scores of random scenes, odd and even seeds apart.

Odd seeds are for working. Even seeds are only reported, so nothing may be changed for the sake of one of them.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.reports.rows import values_of
from benchmarks.reports.tables import COSTS, HIGHER_IS_BETTER, NONE, SCORES
from benchmarks.suite.harness import markdown
from benchmarks.suite.render import RANDOM

COLUMNS = {
    name: (SCORES | COSTS)[name]
    for name in (
        "cd_visible",
        "normal_deg",
        "mask_iou",
        "background_psnr",
        "mse_roughness",
        "mse_metallic",
        "mse_albedo",
        "cpu_seconds",
    )
}
WANTED = {"cd_visible": 0.008, "mse_roughness": 0.01, "mse_metallic": 0.05, "mse_albedo": 0.015}
"""Figure -> the mean over even seeds that the project wants to reach at most."""
WORST = 3
SETS = {"odd": (1, "odd seeds, for working"), "even": (0, "even seeds, only reported")}
"""Marker -> (remainder of the seed by 2, heading)."""


@dataclass
class Scored:
    """What became of a random scene."""

    seed: int
    summary: str
    """the scene in words; empty where it was not rendered"""
    values: dict[str, float]
    """figures of COLUMNS; empty where the job failed"""
    message: str
    """why there are no figures; empty where there are"""
    name: str = ""
    """the name of the run's files; empty where there are none"""

    @property
    def badness(self) -> float:
        """The mean of the figures of WANTED, each divided by what is wanted; infinite where one is missing."""
        if not WANTED.keys() <= self.values.keys():
            return math.inf
        return float(np.mean([self.values[name] / wanted for name, wanted in WANTED.items()]))


def scenes_of(rows: Iterable[dict]) -> list[Scored]:
    """The random scenes of kept rows, in the order of their seeds. Other captures are left out."""
    scenes = [
        Scored(
            int(row["capture"].removeprefix(RANDOM)),
            row.get("scene", ""),
            {name: value for name, value in values_of(row).means.items() if name in COLUMNS},
            row.get("error", ""),
        )
        for row in rows
        if row["capture"].startswith(RANDOM) and row["capture"].removeprefix(RANDOM).isdigit()
    ]
    return sorted(scenes, key=lambda scene: scene.seed)


def part_of(scenes: Sequence[Scored], marker: str) -> list[Scored]:
    """The scenes of one of SETS."""
    return [scene for scene in scenes if scene.seed % 2 == SETS[marker][0]]


def scene_table(scenes: Sequence[Scored]) -> str:
    """A table with a line for each scene. A scene without figures has its message instead."""
    rows = [
        [scene.seed, scene.summary or NONE, *(_cell(scene.values.get(name), name) for name in COLUMNS), scene.message or ""]
        for scene in scenes
    ]
    return markdown(["seed", "scene", *(heading for heading, _ in COLUMNS.values()), "failed"], rows)


def mean_table(scenes: Sequence[Scored]) -> str:
    """The means and the worst values of odd and of even seeds, and how many scenes they count."""
    rows = []
    for marker, (_, heading) in SETS.items():
        own = part_of(scenes, marker)
        scored = [scene for scene in own if not scene.message]
        for word, pick in (("mean", _mean), ("worst", _worst)):
            cells = [_cell(pick([s.values[name] for s in scored if name in s.values], name), name) for name in COLUMNS]
            rows.append([heading, word, f"{len(scored)} of {len(own)}", *cells])
    wanted = [_cell(WANTED.get(name), name) for name in COLUMNS]
    rows.append(["**wanted for even seeds**", "mean", "all", *wanted])
    return markdown(["scenes", "", "scored", *(heading for heading, _ in COLUMNS.values())], rows)


def history(rows: Iterable[dict]) -> str:
    """A table with a line for each commit, preset, and odd or even seeds up to 12 of which all six were run: their means."""
    parts: dict[tuple[str, str, str], list[dict]] = {}
    for row in rows:
        parts.setdefault((row.get("date", ""), row["commit"], row["preset"]), []).append(row)
    lines = []
    for (date, commit, preset), own in sorted(parts.items(), reverse=True):
        for marker in SETS:
            scenes = [scene for scene in part_of(scenes_of(own), marker) if scene.seed <= 12 and not scene.message]
            if len({scene.seed for scene in scenes}) == 6:
                means = [_cell(_mean([s.values[name] for s in scenes if name in s.values], name), name) for name in COLUMNS]
                lines.append([commit, date, preset, marker, *means])
    return markdown(["commit", "date", "preset", "seeds", *(heading for heading, _ in COLUMNS.values())], lines)


def _cell(value: float | None, name: str) -> str:
    return NONE if value is None else f"{value:.{COLUMNS[name][1]}f}"


def _mean(values: list[float], name: str) -> float | None:
    return float(np.mean(values)) if values else None


def _worst(values: list[float], name: str) -> float | None:
    return (min if name in HIGHER_IS_BETTER else max)(values) if values else None


def worst_scenes(scenes: Sequence[Scored]) -> list[Scored]:
    """The WORST scenes of all, the worst first. A scene without figures is worse than any scene with figures."""
    return sorted(scenes, key=lambda scene: -scene.badness)[:WORST]
