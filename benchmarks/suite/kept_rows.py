"""The rows that the repository keeps: one line of JSON a job in `benchmarks/rows/COMMIT.jsonl`. Its README tells the form.

A row of the suite (runner.py) becomes a kept row by `kept`. Sources of kept rows are named by words: a commit or anything
else that git knows, the name of a file in `benchmarks/rows`, `all` of these, a file, or a folder (of kept rows, or the
`--out` of a suite).
"""

from __future__ import annotations

import fcntl
import json
import math
import os
import subprocess
from collections.abc import Iterable, Sequence
from contextlib import contextmanager
from pathlib import Path

from benchmarks.row_files import failure, read_row
from benchmarks.suite.plan import Run
from benchmarks.suite.step import ACTED, STAGE_1
from blender_nep.files import write_text
from blender_nep.safety.isolated_python import NEUTRAL_FOLDER

ROWS = Path(__file__).parents[1] / "rows"
"""The folder of the kept rows in this checkout."""
DEFAULTS = {"ablation": "full", "geometry": "own", "views": None, "pixels": None}
"""Fields of a run that a kept row leaves out where they have these values."""
GROUP = ("capture", "preset", *DEFAULTS)
"""The fields of a run in which runs of several seeds agree."""
ALL = "all"
"""The source that holds all kept rows."""
DIGITS = 5
"""Significant digits of a kept number."""


class SourceError(Exception):
    """A source holds no rows. The message says what to do."""


def kept(row: dict, donor: dict | None = None) -> dict:
    """The kept row of a row of the suite.

    `donor` is the row of the run whose stage 1 this run has taken over: its costs count as the run's own.
    """
    run, learned = row["run"], row.get("learn", {})
    out = {"commit": short(row.get("commits", {}).get("learn") or row.get("machine", {}).get("commit", ""))}
    out["date"] = row.get("machine", {}).get("date", "")
    out |= {key: value for key, value in run.items() if key not in DEFAULTS or value != DEFAULTS[key]}
    if row.get("scene"):
        out["scene"] = row["scene"]
    if photos := row.get("made_from", {}).get("capture"):
        out["photos"] = str(photos)[:12]
    if others := {step: short(own) for step, own in row.get("commits", {}).items() if short(own) != out["commit"]}:
        out["commits"] = others
    if message := failure(row):
        out["error"] = message
    scores = {
        key: value
        for step in ("score", "relight")
        for key, value in row.get(step, {}).items()
        if isinstance(value, int | float) and math.isfinite(value)
    }
    size = {"faces": scores.pop("faces", None), "peak_mb": learned.get("peak_mb")}
    if texture_rows := scores.pop("texture_rows", None):
        size["texels"] = texture_rows**2
    if learned.get("views"):
        size |= {"views_of_run": learned["views"], "pixels_of_run": learned["pixels"] / learned["views"]}
    seconds = {"seconds": learned.get("seconds_total"), "cpu_seconds": learned.get("cpu_seconds")}
    seconds |= {f"seconds_{stage}": value for stage, value in learned.get("seconds", {}).items()}
    seconds |= {f"cpu_seconds_{stage}": value for stage, value in learned.get("stage_cpu_seconds", {}).items()}
    if "stage_1_of" in learned:
        if donor is None or "stage_cpu_seconds" not in donor.get("learn", {}):
            seconds["cpu_seconds"] = None
        else:
            seconds["cpu_seconds"] += sum(donor["learn"]["stage_cpu_seconds"].get(stage, 0) for stage in STAGE_1)
            size["peak_mb"] = max(size["peak_mb"], donor["learn"]["peak_mb"])
    for key, values in (("scores", scores), ("seconds", seconds), ("size", size)):
        if found := {name: _rounded(value) for name, value in values.items() if value is not None}:
            out[key] = found
    out |= {key: _by_code(learned[key]) for key in (*ACTED, "skipped", "versions") if learned.get(key)}
    machine = {key: value for key, value in row.get("machine", {}).items() if key not in ("date", "commit")}
    if machine:
        out["machine"] = machine | ({"device": learned["device"]} if "device" in learned else {})
    return out


def _by_code(value: object) -> object:
    """`value` with each message of the report replaced by its code, because the words of a code stand in the program."""
    if not isinstance(value, dict):
        return value
    return value["code"] if "code" in value else {key: _by_code(part) for key, part in value.items()}


def _rounded(value: float) -> float:
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value


def short(commit: str) -> str:
    """A commit of `commit_now` with 7 digits, as everywhere in the documents, and "-dirty" where it has that."""
    digits, _, dirty = commit.partition("-")
    return digits[:7] + ("-dirty" if dirty else "")


def run_of(row: dict) -> dict:
    """All fields of the run of a kept row. `seed` is None in a row that holds means of several seeds."""
    return {key: row.get(key, DEFAULTS.get(key)) for key in (*GROUP, "seed")}


def group_of(row: dict) -> tuple:
    """What runs of several seeds share: the values of GROUP."""
    return tuple(run_of(row)[key] for key in GROUP)


def keep(row: dict, folder: Path) -> bool:
    """Put a kept row into the file of its commit in `folder`. It takes the place of an older row of the same run.

    Returns False, and keeps nothing, where no commit holds the code of the row. Several processes may call this at once.
    """
    if not row["commit"] or row["commit"].endswith("-dirty"):
        return False
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / f"{row['commit']}.jsonl"
    with _locked(folder):
        others = [other for other in read_lines(file) if run_of(other) != run_of(row)] if file.is_file() else []
        write_lines(file, [*others, row])
    return True


@contextmanager
def _locked(folder: Path):
    """Only one process at a time is within this context, for one folder."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


def write_lines(file: Path, rows: Iterable[dict]) -> None:
    """Write kept rows, one a line, in the order of their runs."""
    ordered = sorted(rows, key=lambda row: [str(value) for value in run_of(row).values()])
    write_text(file, "".join(json.dumps(row, ensure_ascii=False) + "\n" for row in ordered))


def read_lines(file: Path) -> list[dict]:
    """The kept rows of a file. Raises SourceError where a line is no row."""
    rows = []
    for number, line in enumerate(file.read_text(encoding="utf-8").splitlines(), 1):
        if not line.strip():
            continue
        try:
            row = json.loads(line)
        except json.JSONDecodeError as error:
            raise SourceError(f"{file}, line {number} is no JSON: {error.msg}") from None
        if not isinstance(row, dict) or not {"capture", "preset"} <= row.keys():
            raise SourceError(f"{file}, line {number} is no row: it must have `capture` and `preset`")
        rows.append(row)
    return rows


def from_suite(rows: Sequence[dict]) -> list[dict]:
    """The kept rows of a suite's rows."""
    full = {Run.from_json(row["run"]).name: row for row in rows}
    return [kept(row, full.get(row.get("learn", {}).get("stage_1_of", ""))) for row in rows]


def load(out: Path) -> list[dict]:
    """The kept rows of all rows in a suite's folder, sorted by the names of their files."""
    return from_suite([read_row(file) for file in sorted((out / "rows").glob("*.json"))])


def rows_of(source: str, folder: Path = ROWS) -> list[dict]:
    """The kept rows of one source (see the top of this file). Several sources joined by `+` are one.

    Raises SourceError where there are none.
    """
    if "+" in source and not _is_there(source):
        return [row for part in source.split("+") for row in rows_of(part, folder)]
    path = folder if source == ALL else Path(source)
    if path.is_dir():
        rows = [row for file in sorted(path.glob("*.jsonl")) for row in read_lines(file)] or load(path)
    elif path.is_file():
        rows = read_lines(path) if path.suffix == ".jsonl" else from_suite([read_row(path)])
    else:
        file = folder / f"{source}.jsonl"
        if not file.is_file():
            file = folder / f"{_commit_of(source, folder)}.jsonl"
        if not file.is_file():
            raise SourceError(
                f"{source}: {folder} holds no rows of this commit. Run `python -m benchmarks run` with its code, or give "
                "a file or a folder of rows."
            )
        rows = read_lines(file)
    if not rows:
        raise SourceError(f"{source} holds no rows: nothing was run")
    return rows


def _commit_of(name: str, folder: Path) -> str:
    """The 7 digits of the commit that git knows by `name`, such as a branch; `name` cut to 7 where git knows none."""
    checkout = (folder if folder.is_dir() else Path(__file__).parent).absolute()
    git = ["git", "-C", str(checkout), "rev-parse", "--verify", "--quiet", f"{name}^{{commit}}"]
    found = subprocess.run(git, cwd=NEUTRAL_FOLDER, capture_output=True, text=True, check=False).stdout.strip()
    return (found or name)[:7]


def _is_there(source: str) -> bool:
    """Whether a file or a folder has this name. Many commits, joined by `+`, are longer than a name of a file may be."""
    return os.path.exists(source)


def lasting(source: str, folder: Path = ROWS) -> str:
    """The words by which the same rows are found later, too: commits instead of `all`, of a branch or a suite's folder."""
    if source == ALL:
        return "+".join(sorted(file.stem for file in folder.glob("*.jsonl")))
    if _is_there(source):
        commits = sorted({row["commit"] for row in rows_of(source, folder)})
        return "+".join(commits) if all((folder / f"{commit}.jsonl").is_file() for commit in commits) else source
    parts = [part if (folder / f"{part}.jsonl").is_file() else _commit_of(part, folder) for part in source.split("+")]
    return "+".join(parts)


def chosen(sources: Sequence[str], folder: Path = ROWS) -> list[dict]:
    """The kept rows of several sources. Of runs that differ in the seed alone, those of the source named first count."""
    rows: dict[tuple, list[dict]] = {}
    for source in sources:
        own: dict[tuple, list[dict]] = {}
        for row in rows_of(source, folder):
            own.setdefault(group_of(row), []).append(row)
        rows = own | rows
    return [row for group in rows.values() for row in group]
