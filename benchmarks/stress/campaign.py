"""Run whole small jobs on hostile captures, which hypothesis chooses at random.

    python -m benchmarks.stress.campaign --cases 500 --seed 1 --out out/stress
    python -m benchmarks.stress.campaign --cases 0 --files 500                            # damaged files alone
    python -m benchmarks.stress.campaign --case '{"shape": "ring", "pixels": "nan"}'      # run a single case
    python -m benchmarks.stress.campaign --file '{"form": "nero", "change": "bits"}'      # a single damaged file

Each case is a `Case` of scenes.py with up to four hostile fields. A case passes when the job ends with an asset that passes
checks.py, or when it refuses the capture with one clear message and a documented exit code. Then as many captures are read
of which one file is damaged (damaged_files.py). The campaign writes a row for each case (cases/*.json, files/*.json) and a
summary (summary.json). A campaign that was stopped goes on: a case whose row is there is not run again. The exit code is 1
where a case failed, otherwise 0.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import io
import json
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, fields, replace
from pathlib import Path
from typing import Any
from unittest import mock

import torch
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import seed as hypothesis_seed
from hypothesis import strategies as st

from benchmarks.row_files import write_row
from benchmarks.stress.checks import check_asset, check_refusal, same_assets, strict_json
from benchmarks.stress.damaged_files import DamagedFile, damaged_files, run_damaged
from benchmarks.stress.scenes import Case, write_capture
from blender_nep.job import runner as job
from blender_nep.job.reporting.events import Events
from blender_nep.materials import fitting as material_fits
from blender_nep.stop_request import StopRequest

SCENES = {
    "shape": ["sphere", "box", "plate", "ring", "holes"],
    "albedo": [0.6, 0.0, 1.0],
    "roughness": [0.3, 0.02, 1.0],
    "metallic": [1.0, 0.0],
    "light": ["lamps", "blinding", "uniform"],
    "views": [8, 10, 14],
    "size": [24, 32, 48],
    "suffix": [".exr", ".png"],
    "masks": ["none", "files", "alpha"],
    "bounds": ["given", "estimated"],
    "told": ["auto", "yes", "no"],
    "materials": [1, 4],
    "seed": [0, 1, 2**32 + 5],
}
"""Fields of scenes that a user may well have -> their values. Every case has a value of each."""
TROUBLES = {
    "shape": ["nothing"],
    "light": ["dark"],
    "views": [3, 4],
    "size": [9, 16],
    "masks": ["wrong"],
    "bounds": ["large", "small", "elsewhere", "zero"],
    "scale": [1e-4, 1e4, 1e-2, 37.0],
    "offset": [1e6, -1e4],
    "distance": [100.0, 30.0, 1.05, 0.5],
    "zoom": [False],
    "duplicates": ["some", "pairs", "all"],
    "turntable": ["told", "untold", "walk"],
    "roll": [1.5707963, 3.1, 0.4],
    "shift": [0.3, 0.8],
    "mesh": ["true", "soup", "inside_out"],
    "pixels": [
        "nan",
        "negative",
        "inf",
        "huge",
        "saturated",
        "white",
        "black",
        "one_black",
        "one_nan",
        "most_nan",
        "noise",
        "flat",
    ],
    "explanation": [True],
    "threads": [2],
    "bfloat16": [True],
    "stop": ["fields_learning:3", "fields_learning:17", "material_learning:70", "material_learning:80", "surface:0"],
}
"""Fields with hostile values -> these values. A case has up to four of these fields."""
_ROUGHNESS_STEPS = 6
"""Roughnesses that each fit tries, instead of 28. Trying them takes most of the time of a job on a tiny capture."""


@st.composite
def cases(draw: st.DrawFn, most: int = 4) -> Case:
    """A random case: a scene of SCENES with up to `most` of the TROUBLES."""
    chosen = {name: draw(st.sampled_from(values)) for name, values in SCENES.items()}
    for name in draw(st.lists(st.sampled_from(list(TROUBLES)), max_size=most, unique=True)):
        chosen[name] = draw(st.sampled_from(TROUBLES[name]))
    return Case(**chosen)


class _StopAt(StopRequest):
    """A request to stop that is made when the job reaches "stage:step"."""

    def __init__(self, where: str) -> None:
        super().__init__()
        self.stage, step = where.split(":")
        self.step = int(step)

    def see(self, event: str, **content) -> None:
        if event == "progress" and content["stage"] == self.stage and content["step"] >= self.step:
            self.request("stress")


class _AllEvents(Events):
    """Events that pass every step on to the request to stop, so that the job stops at the same step each time."""

    def __init__(self, protocol, human, stop: StopRequest) -> None:
        super().__init__(protocol, human)
        self._watch = getattr(stop, "see", None)

    def progress(self, stage, step, steps, fraction, eta, loss, **extra) -> None:
        super().progress(stage, step, steps, fraction, eta, loss, **extra)
        if self._watch is not None:
            self._watch("progress", stage=stage, step=step)


def reconstruct(
    case: Case, capture: Path, out: Path, stop: StopRequest | None = None, **changes
) -> tuple[int, list[dict], str]:
    """Run the job of a case: (exit code, events, the text that the job writes for people)."""
    protocol, human, stop = io.StringIO(), io.StringIO(), stop or StopRequest()
    lowered = torch.autocast("cpu", torch.bfloat16) if case.bfloat16 else contextlib.nullcontext()
    with lowered, mock.patch.object(material_fits, "_ROUGHNESS", _ROUGHNESS_STEPS):
        code = job.run(case.settings(capture, out, **changes), _AllEvents(protocol, human, stop), stop)
    return code, [strict_json(line) for line in protocol.getvalue().splitlines()], human.getvalue()


def run_case(case: Case, folder: Path) -> dict:
    """Make the capture of a case in the empty folder `folder`, run the job, and check its result.

    Returns {"code", "failures", "resumed", "message", "warnings", "seconds"}.
    """
    capture, out, start, was_resumed = folder / "capture", folder / "asset", time.monotonic(), False
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        write_capture(case, capture)
        told.clear()
        code, events, human = reconstruct(case, capture, out)
        failures = check_refusal(code, events, human, out) if code else check_asset(case, out)
        if code == 0 and case.stop != "none":
            found, was_resumed = _resume(case, capture, folder)
            failures += found
    failures += sorted(
        {
            f"numerical warning: {Path(w.filename).name}:{w.lineno} {w.message}"
            for w in told
            if issubclass(w.category, RuntimeWarning)
        }
    )
    if code == 1:
        log = out / "log.txt"
        failures.append("traceback: " + (log.read_text() if log.is_file() else human)[-1500:])
    return {
        "code": code,
        "failures": failures,
        "resumed": was_resumed,
        "message": next((e["message"] for e in events if e["event"] == "error"), ""),
        "warnings": [e["message"] for e in events if e["event"] == "warning"],
        "seconds": round(time.monotonic() - start, 2),
    }


def _resume(case: Case, capture: Path, folder: Path) -> tuple[list[str], bool]:
    """Stop the same job in its middle and resume it from disk. The asset must be the same, bit for bit.

    Returns (failures, whether the job was stopped). The job is not stopped where the stage ends, or is left out, before the
    step at which it should be stopped.
    """
    out = folder / "stopped"
    code, events, human = reconstruct(case, capture, out, _StopAt(case.stop))
    if code != 7:
        return ([f"not stopped at {case.stop}: exit code {code}"] if code else []), False
    code, events, human = reconstruct(case, capture, out, resume=True)
    if code:
        return [f"not resumed: {events[-1]}", *check_refusal(code, events, human, out)], True
    return same_assets(folder / "asset", out), True


def digest(case: Case | DamagedFile) -> str:
    """A short name of the case, made from all its fields."""
    return hashlib.sha256(json.dumps(asdict(case), sort_keys=True).encode()).hexdigest()[:12]


def campaign(count: int, seed: int, out: Path, files: int = 0) -> dict:
    """Run `count` different cases and read `files` damaged captures, or fewer where hypothesis finds no more.

    Returns the summary. A case that has a row in `out` is not run again.
    """
    rows = _run_all(cases(), run_case, count, seed, out / "cases")
    damaged = _run_all(damaged_files(), run_damaged, files, seed, out / "files")
    summary = summarize(rows) | {"seed": seed, "files": summarize_files(damaged)}
    write_row(out / "summary.json", summary)
    return summary


def _run_all(
    strategy: st.SearchStrategy, run: Callable[[Any, Path], dict], count: int, seed: int, out: Path
) -> dict[str, dict]:
    """{name: row} of `count` different cases, or of fewer where hypothesis finds no more."""
    rows: dict[str, dict] = {}
    if not count:
        return rows

    @hypothesis_seed(seed)
    @settings(
        max_examples=4 * count,
        database=None,
        deadline=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(strategy)
    def each(case: Any) -> None:
        name = digest(case)
        if name in rows or len(rows) >= count:
            return
        file = out / f"{name}.json"
        if not file.is_file():
            with tempfile.TemporaryDirectory() as folder:
                write_row(file, {"case": asdict(case), **run(case, Path(folder))})
        rows[name] = json.loads(file.read_text())
        if rows[name]["failures"]:
            print(name, rows[name]["failures"][0][:200], file=sys.stderr, flush=True)

    each()
    return rows


def summarize_files(rows: dict[str, dict]) -> dict:
    """The counts of the damaged files: exit codes, refusals, and how much time and memory the largest case took."""
    return {
        "cases": len(rows),
        "failed": [name for name, row in rows.items() if row["failures"]],
        "failures_by_kind": dict(Counter(f.split(":")[0] for row in rows.values() for f in row["failures"])),
        "exit_codes": dict(Counter(str(row["code"]) for row in rows.values())),
        "read_with_warnings": sum(row["code"] == 0 and bool(row["warnings"]) for row in rows.values()),
        "targets": dict(Counter(row["case"]["target"] for row in rows.values())),
        "most_seconds": max((row["seconds"] for row in rows.values()), default=0.0),
        "most_megabytes": max((row["megabytes"] for row in rows.values()), default=0),
    }


def summarize(rows: dict[str, dict]) -> dict:
    """The counts of a campaign: exit codes, failures of each kind, and how often each unusual value of a field occurred."""
    kinds = Counter(f.split(":")[0] for row in rows.values() for f in row["failures"])
    plain = Case()
    met = Counter(
        f"{f.name}={row['case'][f.name]}"
        for row in rows.values()
        for f in fields(Case)
        if row["case"][f.name] != getattr(plain, f.name)
    )
    return {
        "cases": len(rows),
        "failed": [name for name, row in rows.items() if row["failures"]],
        "failures_by_kind": dict(kinds),
        "exit_codes": dict(Counter(str(row["code"]) for row in rows.values())),
        "refusals": dict(Counter(_kind_of(row["message"]) for row in rows.values() if row["code"])),
        "assets_with_warnings": sum(row["code"] == 0 and bool(row["warnings"]) for row in rows.values()),
        "resumed": sum(row["resumed"] for row in rows.values()),
        "seconds": round(sum(row["seconds"] for row in rows.values()), 1),
        "met": dict(met.most_common()),
    }


def _kind_of(message: str) -> str:
    """An error message without its numbers and names, so that equal messages are counted together."""
    return " ".join("#" if any(c.isdigit() for c in word) else word for word in message.split())[:80]


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.stress.campaign", description=__doc__.split("\n")[0])
    parser.add_argument("--cases", type=int, default=500)
    parser.add_argument("--files", type=int, help="so many captures with a damaged file; default: as many as --cases")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("out/stress"))
    parser.add_argument("--case", type=json.loads, help="run one case, given as JSON of the fields that it changes")
    parser.add_argument("--file", type=json.loads, help="run one damaged file, given as JSON of the fields that it changes")
    options = parser.parse_args(arguments)
    if options.case is not None or options.file is not None:
        with tempfile.TemporaryDirectory() as folder:
            if options.case is not None:
                row = run_case(replace(Case(), **options.case), Path(folder))
            else:
                row = run_damaged(replace(DamagedFile(), **options.file), Path(folder))
        print(json.dumps(row, indent=1))
        return 1 if row["failures"] else 0
    files = options.cases if options.files is None else options.files
    summary = campaign(options.cases, options.seed, options.out, files)
    print(json.dumps(summary, indent=1))
    return 1 if summary["failed"] or summary["files"]["failed"] else 0


if __name__ == "__main__":
    sys.exit(main())
