"""Runs the runs of a plan. Each run is learned, scored and relit; each of these steps is a separate process.

    OUT/rows/NAME.json     the run's row: {"run": ..., "made_from": ..., "machine": ..., "commits": {step: commit},
                           "learn": ..., "score": ..., "relight": ...}
    OUT/assets/NAME/       the asset; a run without ablation keeps the checkpoints of its stage 1
    OUT/pictures/          materials and relit objects beside the true ones
    OUT/logs/              what the steps printed
    ROWS/COMMIT.jsonl      what is kept of the rows, one line a run (kept_rows.py), where a commit holds the code

A step that is in the row is not done again. A step that failed is in the row too, with its message. `made_from` tells the
capture and the preset (see identity.py). Rows of another capture or preset are refused, or done again with `retry`. Older
rows without `made_from` are taken as they are.
"""

from __future__ import annotations

import fcntl
import os
import platform
import shutil
import sys
from collections.abc import Sequence
from concurrent.futures import Future, ThreadPoolExecutor, as_completed, wait
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path

from benchmarks.row_files import failure, read_row, write_row
from benchmarks.suite.harness import Children, command_of, commit_now
from benchmarks.suite.kept_rows import keep, kept
from benchmarks.suite.plan import Run
from benchmarks.suite.step import ACTED, STAGE_1


class OtherRowsError(Exception):
    """Rows of another capture or preset are in the way. The message says what to do."""


@dataclass
class Suite:
    """Runs the steps of runs, and writes their results into `out`."""

    out: Path
    threads: int = 1
    device: str = "auto"
    limit: float = 7200.0
    """Seconds after which a step is killed."""
    relight: bool = False
    """Whether whole jobs, as a user would run them (`Run.is_plain`), are scored in Cycles too."""
    retry: bool = False
    """Whether steps that failed, and rows of another capture or preset, are done again."""
    rows: Path | None = None
    """The folder in which kept rows are; None to keep none."""
    children: Children = field(default_factory=Children)
    made_from: dict[str, dict] = field(default_factory=dict)
    """Name of a run -> what it is made from now. `run_all` fills it."""

    def __post_init__(self) -> None:
        self.out = self.out.absolute()  # the steps have another current folder

    def run_all(self, runs: Sequence[Run], jobs: int) -> int:
        """Run all runs in their order, `jobs` of them at once. Returns how many have failed.

        Raises OtherRowsError, before anything runs, where there are rows of another capture or preset.
        """
        self.made_from = self.identify(runs)
        self._refuse_other_rows(runs)
        commit, failed = commit_now(), 0
        if self.rows and not is_same_code(commit, commit):
            print(f"no commit holds this code: rows are in {self.out} alone, none in {self.rows}", file=sys.stderr)
        with ThreadPoolExecutor(jobs) as pool:
            started: dict[str, Future] = {}
            for run in runs:
                # The run that this run waits for was given to the pool before this run. So waiting for it always ends.
                donor = run.same_stage_1 or (replace(run, ablation="full") if run.without else None)
                started[run.name] = pool.submit(self._run_after, run, started.get(donor.name) if donor else None)
            try:
                for done, future in enumerate(as_completed(started.values()), 1):
                    row, name = future.result(), next(n for n, f in started.items() if f is future)
                    failed += bool(failure(row))
                    said = "not run, because what it leaves out does not act" if "idle" in row else failure(row) or "done"
                    print(f"{done}/{len(runs)} {name}: {said}", file=sys.stderr, flush=True)
            except KeyboardInterrupt:
                self.children.stopped = True
                pool.shutdown(cancel_futures=True)
                raise
        return failed

    def _run_after(self, run: Run, other: Future | None) -> dict:
        if other is not None:
            wait([other])
        return {"idle": True} if self._is_idle(run) else self.run(run)

    def _is_idle(self, run: Run) -> bool:
        """Whether all that the run's ablation leaves out was skipped in the run without ablation, by the same code.

        Then both runs are the same, bit for bit, and this one need not run.
        """
        row, now = read_row(self._row_file(replace(run, ablation="full"))), commit_now()
        learned = row.get("learn", {})
        found = {name: what for part in ACTED for name, what in learned.get(part, {}).items()}
        if not run.without or not is_same_code(row.get("commits", {}).get("learn", ""), now):
            return False
        return all("skipped" in found.get(name, {}) for name in run.without)

    def run(self, run: Run) -> dict:
        """Do the steps of one run that its row does not hold yet, and return the row.

        Where another runner is at work on the same run, this one waits for it first.
        """
        for folder in ("logs", "pictures"):
            (self.out / folder).mkdir(parents=True, exist_ok=True)
        with open(self.out / "logs" / f"{run.name}.lock", "w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            return self._run_steps(run)

    def _run_steps(self, run: Run) -> dict:
        self._refuse_other_rows([run])  # another runner may have made a row since `run_all` has looked
        file, asset = self._row_file(run), self.out / "assets" / run.name
        row = {} if self._differing(run) else read_row(file)
        if not row:
            made_from = self.made_from.get(run.name)
            row = {"run": run.as_row()} | ({"made_from": made_from} if made_from else {})
        if scene := read_row(run.capture / "scene.json").get("summary"):
            row["scene"] = scene
        steps = ["learn", "score", *(["relight"] if self.relight and run.is_plain else [])]
        for step in steps:
            if step in row and not (self.retry and "error" in row[step]):
                if "error" in row[step] and step == "learn":
                    break
                continue
            if self.children.stopped:
                break
            commit = commit_now()  # before the step, because the code may change while it runs
            result = self.run_step(step, run, asset)
            if self.children.stopped:
                break
            if step == "learn":
                row |= {"machine": machine(self.threads)}
                for old in ("score", "relight", "commits"):
                    row.pop(old, None)
            row[step] = result
            row["commits"] = row.get("commits", {}) | {step: commit}
            write_row(file, row)
            self._keep(row, run)
            if step == "learn" and "error" in result:
                break
            if step == "score" and "error" not in result:
                _drop_checkpoints(asset, keep=STAGE_1 if run.ablation == "full" else ())
        return row

    def _keep(self, row: dict, run: Run) -> None:
        """Put what is kept of a row into `rows`."""
        if self.rows:
            donor = run.same_stage_1
            keep(kept(row, read_row(self._row_file(donor)) if donor else None), self.rows)

    def identify(self, runs: Sequence[Run]) -> dict[str, dict]:
        """Name -> what each run is made from now (`identity.made_from`). Raises OSError where that cannot be found out."""
        (self.out / "logs").mkdir(parents=True, exist_ok=True)
        log = self.out / "logs" / "identity.log"
        order, result = (self.out / "logs" / f"identity.{os.getpid()}.{kind}.json" for kind in ("order", "result"))
        write_row(order, {run.name: run.as_json() for run in runs})
        command = command_of("benchmarks.suite.identity", order, result)
        ended = self.children.run(command, log, self.threads, self.limit)
        found = read_row(result)
        for file in (order, result):
            file.unlink(missing_ok=True)
        if ended.code:
            raise OSError(f"the captures could not be looked at (code {ended.code}): {last_line(log)}")
        return found

    def _donor(self, run: Run) -> Run | None:
        """The run whose stage 1 this run can take over: it must have learned with exactly the present code."""
        donor = run.same_stage_1
        if donor is None:
            return None
        learned_with = read_row(self._row_file(donor)).get("commits", {}).get("learn", "")
        return donor if is_same_code(learned_with, commit_now()) else None

    def _row_file(self, run: Run) -> Path:
        return self.out / "rows" / f"{run.name}.json"

    def _differing(self, run: Run) -> list[str]:
        """The parts of the run's row that say that it was made from something else than the run is made from now."""
        now, then = self.made_from.get(run.name), read_row(self._row_file(run)).get("made_from")
        return [part for part in now if now[part] != then.get(part)] if now and then else []

    def _refuse_other_rows(self, runs: Sequence[Run]) -> None:
        """Raises OtherRowsError where rows of another capture or preset are there and are not to be done again."""
        others = {run.name: differing for run in runs if (differing := self._differing(run))}
        if others and not self.retry:
            name, differing = next(iter(others.items()))
            more = f" (and {len(others) - 1} more)" if len(others) > 1 else ""
            raise OtherRowsError(
                f"the row {name}{more} in {self.out} was made from another {', '.join(differing)}. Give another --out, or "
                "--retry to do such rows again."
            )

    def run_step(self, step: str, run: Run, asset: Path) -> dict:
        """Do one step of one run in a separate process, and return what belongs into the row."""
        folder = self.out / "logs"
        order, result = (folder / f"{run.name}.{step}.{kind}" for kind in ("order.json", "result.json"))
        result.unlink(missing_ok=True)
        donor = self._donor(run)
        write_row(
            order,
            {
                "step": step,
                "run": run.as_json(),
                "asset": str(asset),
                "settings": {"device": self.device, "threads": self.threads},
                "variant": str(self.out / "captures" / f"{run.capture.name}_{run.views}_views"),
                "stage_1": donor and str(self.out / "assets" / donor.name),
                "albedo_ratio": read_row(self._row_file(run)).get("score", {}).get("albedo_ratio"),
                "truth": str(self.out / "truth" / f"{run.capture.name}.npz"),
                "picture": str(self.out / "pictures" / f"{run.name}.{step}.png"),
            },
        )
        log = folder / f"{run.name}.log"
        ended = self.children.run(command_of("benchmarks.suite.step", order, result), log, self.threads, self.limit)
        found = read_row(result)
        if ended.timed_out:
            found = {"error": f"killed after {self.limit:.0f} s"}
        elif not found:
            found = {"error": f"ended with code {ended.code}: {last_line(log)}"}
        if step == "learn":
            found |= {"wall_seconds": ended.seconds, "cpu_seconds": ended.cpu_seconds, "peak_mb": ended.peak_mb}
            if donor and found.get("resumed_stages"):
                found["stage_1_of"] = donor.name
        for file in (order, result):
            file.unlink(missing_ok=True)
        return found


def last_line(log: Path) -> str:
    lines = [line.strip() for line in log.read_text(encoding="utf-8", errors="replace").splitlines()]
    return next((line for line in reversed(lines) if line), "")[:200]


def _drop_checkpoints(asset: Path, keep: Sequence[str]) -> None:
    kept = {f"{stage}.done.pt" for stage in keep}
    for file in (asset / "checkpoints").glob("*"):
        if file.name not in kept:
            file.unlink()
    if not kept:
        shutil.rmtree(asset / "checkpoints", ignore_errors=True)


def is_same_code(one: str, other: str) -> bool:
    """Whether two commits of `commit_now` stand for the same code. Code that no commit holds may be any code."""
    return one == other != "" and not one.endswith("-dirty")


def machine(threads: int) -> dict:
    """The computer that a run learned on, without its name, and the date."""
    processor = platform.processor() or platform.machine()
    if Path("/proc/cpuinfo").is_file():
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        processor = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), processor)
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    return {
        "system": platform.system(),
        "processor": processor,
        "cores": os.cpu_count(),
        "memory_gb": round(memory, 1),
        "threads": threads,
        "date": datetime.now().date().isoformat(),
    }
