"""Says what got better or worse from one set of kept rows to another, beyond what seeds do.

Runs are paired by all fields but the seed. The spread of a score is the pooled standard deviation of the seeds of both
sides. A difference of means counts where Student's t makes it improbable, and where it is at least LEAST and a digit of the
tables. Of all differences that count, CHANCE come from seeds alone (Benjamini and Hochberg, 1995). So a comparison of equal
code finds any difference once in twenty times.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from scipy.stats import t as student

from benchmarks.reports.rows import Figure, Results
from benchmarks.reports.tables import HIGHER_IS_BETTER, SCORES
from benchmarks.suite.harness import markdown
from benchmarks.suite.kept_rows import group_of, run_of
from benchmarks.suite.step import ACTED

CHANCE = 0.05
"""The share of chance among the differences that count."""
LEAST = 1e-4
"""Smallest difference of a score that counts. Rows that were taken from tables have four digits."""
SECONDS = ("cpu_seconds", "seconds")


@dataclass(frozen=True)
class Difference:
    """One score before (a) and after (b). `spread` is the deviation of b - a, and `freedom` its degrees of freedom."""

    name: str
    a: float
    b: float
    spread: float
    freedom: int

    @property
    def gain(self) -> float:
        """How much better b is than a, in the score's unit; below 0: worse."""
        return (self.b - self.a) * (1 if self.name in HIGHER_IS_BETTER else -1)

    @property
    def shows(self) -> bool:
        """Whether this difference is so large that the tables show it."""
        return abs(self.gain) >= max(LEAST, 10.0 ** -SCORES[self.name][1]) * (1 - 1e-9)

    @property
    def probability(self) -> float:
        """How probable a difference of this size is, if only seeds differ; 1 where their spread is not known."""
        if self.freedom < 1 or self.gain == 0:
            return 1.0
        return 2 * float(student.sf(abs(self.gain) / self.spread, self.freedom)) if self.spread else 0.0


def beyond_chance(differences: Sequence[Difference]) -> float:
    """The largest probability of a difference that counts; below 0 where none does."""
    found = sorted(one.probability for one in differences if one.freedom)
    return max((p for rank, p in enumerate(found, 1) if p <= CHANCE * rank / len(found)), default=-1.0)


def difference(name: str, a: Figure, b: Figure) -> Difference:
    """The difference of one score of one pair. One seed on each side has no spread: `freedom` is 0."""
    freedom = a.runs + b.runs - 2
    squares = (a.runs - 1) * a.deviation**2 + (b.runs - 1) * b.deviation**2
    spread = math.sqrt(squares / freedom * (1 / a.runs + 1 / b.runs)) if freedom else math.inf
    return Difference(name, a.mean, b.mean, spread, freedom)


def mean_of(parts: Sequence[Difference]) -> Difference:
    """The difference of the means over captures."""
    count = len(parts)
    spread = math.sqrt(sum(part.spread**2 for part in parts)) / count
    means = [sum(getattr(part, side) for part in parts) / count for side in ("a", "b")]
    return Difference(parts[0].name, *means, spread, sum(part.freedom for part in parts))


@dataclass
class Pair:
    """The rows of one group of runs before and after."""

    name: str
    family: str
    """The group's name without its capture: means are over the captures of a family"""
    seeds: tuple[int, int]
    scores: list[Difference]
    ratios: dict[str, float]
    """Seconds after, divided by seconds before, by their names"""
    fails: bool
    """Whether more of its runs fail after than before"""
    notes: list[str]


@dataclass
class Comparison:
    """What `compare` found."""

    pairs: list[Pair]
    means: dict[str, list[Difference]]
    """{family: differences of the means over its captures}; families of one capture have none"""
    alone: tuple[list[str], list[str]]
    """Names of the groups that only a has, and that only b has"""
    better: list[tuple[str, Difference]] = field(init=False)
    worse: list[tuple[str, Difference]] = field(init=False)

    def __post_init__(self) -> None:
        own = [(pair.name, one) for pair in self.pairs for one in pair.scores]
        own += [(f"{family}, mean", one) for family, parts in self.means.items() for one in parts]
        limit = beyond_chance([one for _, one in own])
        beyond = [(name, one) for name, one in own if one.probability <= limit and one.shows]
        self.better = [(name, one) for name, one in beyond if one.gain > 0]
        self.worse = [(name, one) for name, one in beyond if one.gain < 0]

    @property
    def got_worse(self) -> bool:
        """Whether a score is worse beyond the spread of seeds, or more runs fail."""
        return bool(self.worse) or any(pair.fails for pair in self.pairs)

    def text(self, a: str, b: str) -> str:
        """The whole comparison in Markdown. `a` and `b` are the names of the two sides."""
        if not self.pairs:
            return f"{a} and {b} share no capture and preset: nothing can be compared"
        beyond = {(name, one.name): ("better" if one.gain > 0 else "WORSE") for name, one in self.better + self.worse}
        several = any(sum(pair.seeds) > 2 for pair in self.pairs)
        parts = []
        for heading, found in (("Worse", self.worse), ("Better", self.better)):
            lines = [f"- {name}: {_line(one)}" for name, one in found]
            if found is self.worse:
                lines += [f"- {pair.name}: more runs fail" for pair in self.pairs if pair.fails]
            lines = lines or ["- nothing beyond the spread of seeds" if several else "- nothing can be said of one seed"]
            parts.append(f"{heading} from {a} to {b}:\n\n" + "\n".join(lines))
        if silent := [pair.name for pair in self.pairs if sum(pair.seeds) == 2]:
            parts.append(
                "One seed on each side, so nothing can be said of " + "; ".join(silent) + ". Run more seeds, for example "
                "`--seed 0 1 2`."
            )
        rows = [
            [name, seeds, *_cells(one), beyond.get((name, one.name), "?" if not one.freedom else "")]
            for name, seeds, scores in [
                *((f"{family}, mean", "", scores) for family, scores in self.means.items()),
                *((pair.name, "{} / {}".format(*pair.seeds), pair.scores) for pair in self.pairs),
            ]
            for one in scores
        ]
        parts.append(markdown(["runs", "seeds", "score", a, b, "b - a", "by chance ±", ""], rows))
        parts.append(markdown(["runs", *(f"{name}, {b} / {a}" for name in SECONDS)], self._ratios()))
        notes = [f"- {pair.name}: {note}" for pair in self.pairs for note in pair.notes]
        notes += [f"- only {side}: {', '.join(names)}" for side, names in zip((a, b), self.alone, strict=True) if names]
        return "\n\n".join(parts + (["\n".join(notes)] if notes else []))

    def _ratios(self) -> list[list[str]]:
        """The table's lines of seconds, last their geometric means. Seconds decide nothing: other programs change them."""

        def line(name: str, pairs: Sequence[Pair]) -> list[str]:
            return [name, *(_ratio([pair.ratios[key] for pair in pairs if key in pair.ratios]) for key in SECONDS)]

        return [*(line(pair.name, [pair]) for pair in self.pairs), line("mean", self.pairs)]


def _ratio(ratios: Sequence[float]) -> str:
    return f"{math.exp(sum(map(math.log, ratios)) / len(ratios)):.2f}" if ratios else "-"


def _cells(one: Difference) -> list[str]:
    heading, digits = SCORES[one.name]
    digits += 1
    by_chance = f"{one.spread:.{digits}f}" if one.freedom else "one seed"
    return [heading, f"{one.a:.{digits}f}", f"{one.b:.{digits}f}", f"{one.b - one.a:+.{digits}f}", by_chance]


def _line(one: Difference) -> str:
    heading, a, b, change, _ = _cells(one)
    return f"{heading} {a} -> {b} ({change})"


def compare(a: Iterable[dict], b: Iterable[dict]) -> Comparison:
    """Compare two sets of kept rows, a before and b after. Runs that failed are notes and have no figures."""
    sides: list[dict[tuple, list[dict]]] = [{}, {}]
    for side, rows in zip(sides, (a, b), strict=True):
        for row in rows:
            side.setdefault(group_of(row), []).append(row)
    shared = [group for group in sides[0] if group in sides[1]]
    pairs = [_pair(group, sides[0][group], sides[1][group]) for group in shared]
    families: dict[str, dict[str, list[Difference]]] = {}
    for pair in pairs:
        for one in pair.scores:
            if one.freedom:
                families.setdefault(pair.family, {}).setdefault(one.name, []).append(one)
    means = {
        family: [mean_of(parts) for parts in scores.values() if len(parts) > 1]
        for family, scores in families.items()
        if any(len(parts) > 1 for parts in scores.values())
    }
    alone = tuple([_name(group) for group in one if group not in other] for one, other in (sides, sides[::-1]))
    return Comparison(pairs, means, (alone[0], alone[1]))


def with_ablation(a: Iterable[dict], b: Iterable[dict], ablation: str) -> tuple[list[dict], list[dict]]:
    """The whole jobs of a, and the rows of b with `ablation` as if they had none, so that `compare` pairs them."""
    whole = [row for row in a if run_of(row)["ablation"] == "full"]
    changed = [row for row in b if run_of(row)["ablation"] == ablation]
    return whole, [{key: value for key, value in row.items() if key != "ablation"} for row in changed]


def _name(group: tuple) -> str:
    """The group in words: its capture and preset, and what differs from a whole job."""
    capture, preset, ablation, geometry, views, pixels = group
    words = [capture, preset, *([ablation] if ablation != "full" else []), *(["true mesh"] if geometry == "true" else [])]
    return " ".join([*words, *([f"{views} views"] if views else []), *([f"{pixels} pixels"] if pixels else [])])


def _pair(group: tuple, a: list[dict], b: list[dict]) -> Pair:
    results = [Results(rows) for rows in (a, b)]
    figures = [{name: figure for name in (*SCORES, *SECONDS) if (figure := one.figure(name))} for one in results]
    shared = [name for name in figures[0] if name in figures[1]]
    return Pair(
        name=_name(group),
        family=_name(("", *group[1:])).strip(),
        seeds=(results[0].count, results[1].count),
        scores=[difference(name, figures[0][name], figures[1][name]) for name in shared if name in SCORES],
        ratios={name: figures[1][name].mean / figures[0][name].mean for name in shared if name in SECONDS},
        fails=sum("error" in row for row in b) > sum("error" in row for row in a),
        notes=_notes(a, b),
    )


def _notes(a: list[dict], b: list[dict]) -> list[str]:
    """What else differs: runs that failed, other photos, other processors, and what acted."""
    sides = (("before", a), ("after", b))
    notes = [f"failed {side}: {row['error']}" for side, rows in sides for row in rows if "error" in row]
    photos = [{row["photos"] for row in rows if "photos" in row} for rows in (a, b)]
    processors = [{row.get("machine", {}).get("processor") for row in rows} - {None} for rows in (a, b)]
    for word, kinds in (("photos", photos), ("processors", processors)):
        if all(kinds) and kinds[0] != kinds[1]:
            notes.append(f"other {word} than before")
    acted = [[acting(row) for row in rows if any(part in row for part in ACTED)] for rows in (a, b)]
    if all(acted):
        before, after = (set.union(*names) for names in acted)
        notes += [f"{name} did not act before" for name in sorted(after - before)]
        notes += [f"{name} does not act any more" for name in sorted(before - after)]
    return notes


def acting(row: dict) -> set[str]:
    """The names of the refinements and of the evidence that acted on a run."""
    return {name for part in ACTED for name, what in row.get(part, {}).items() if what.get("acted")}
