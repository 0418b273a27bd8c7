"""The rows that the repository keeps: their form, their files, and the words that name them."""

import json
import subprocess
import threading
from dataclasses import replace
from pathlib import Path

import pytest

pytest.importorskip("fcntl", reason="the suite runs on POSIX systems")
from benchmarks.row_files import write_row
from benchmarks.suite import runner
from benchmarks.suite.kept_rows import ROWS, SourceError, keep, kept, lasting, load, read_lines, rows_of, run_of
from benchmarks.suite.plan import Run
from benchmarks.suite.runner import Suite
from support.paths import SUZANNE_SMALL

COARSE = {"code": "reason.coarse", "values": {}, "message": "the photos are too coarse"}
LEARNED = {
    "device": "cpu",
    "versions": {"torch": "2.13.0"},
    "seconds": {"fields_learning": 60.0, "surface": 2.0},
    "seconds_total": 100.123456,
    "cpu_seconds": 90.0,
    "peak_mb": 1000.0,
    "views": 40,
    "pixels": 40 * 2_500,
    "stage_cpu_seconds": {"fields_learning": 50.0, "surface": 1.5},
    "skipped": {"relief": COARSE},
    "refinements": {"carve": {"acted": [0.5]}, "relief": {"skipped": COARSE}},
}
SCORE = {
    "cd_visible": 0.00123456789,
    "mse_albedo": float("nan"),
    "albedo_ratio": [1, 1, 1],
    "faces": 5000,
    "texture_rows": 256,
}


def row_of(run: Run, commit: str = "1234abcd", **learned) -> dict:
    """A row of the form that the suite writes."""
    return {
        "run": run.as_row(),
        "made_from": {"capture": "0123456789abcdef", "preset": {}},
        "machine": {"processor": "a core", "threads": 1, "date": "2026-11-21"},
        "commits": {"learn": commit, "score": commit},
        "learn": LEARNED | learned,
        "score": SCORE,
    }


def test_a_kept_row_says_what_ran_what_it_cost_and_what_acted():
    assert kept(row_of(Run(Path("a/box"), "preview", "no cones", seed=2)) | {"scene": "a box"}) == {
        "commit": "1234abc",
        "date": "2026-11-21",
        "capture": "box",
        "preset": "preview",
        "ablation": "no cones",
        "seed": 2,
        "scene": "a box",
        "photos": "0123456789ab",
        "scores": {"cd_visible": 0.0012346},
        "seconds": {
            "seconds": 100.12,
            "cpu_seconds": 90.0,
            "seconds_fields_learning": 60.0,
            "seconds_surface": 2.0,
            "cpu_seconds_fields_learning": 50.0,
            "cpu_seconds_surface": 1.5,
        },
        "size": {"faces": 5000, "peak_mb": 1000.0, "texels": 65536, "views_of_run": 40, "pixels_of_run": 2500.0},
        "refinements": {"carve": {"acted": [0.5]}, "relief": {"skipped": "reason.coarse"}},
        "skipped": {"relief": "reason.coarse"},
        "versions": {"torch": "2.13.0"},
        "machine": {"processor": "a core", "threads": 1, "device": "cpu"},
    }


def test_a_stage_1_that_was_taken_over_counts_in_a_kept_row():
    row, donor = row_of(Run(Path("box")), stage_1_of="other", cpu_seconds=20.0), row_of(Run(Path("box")), peak_mb=3000.0)
    assert kept(row, donor)["seconds"]["cpu_seconds"] == 71.5 and kept(row, donor)["size"]["peak_mb"] == 3000.0
    assert "cpu_seconds" not in kept(row)["seconds"], "without the other run's row, the seconds are not known"


def test_a_failed_run_is_kept_with_its_message():
    failed = row_of(Run(Path("box"))) | {"learn": {"error": "no surface was found"}}
    failed.pop("score")
    assert kept(failed)["error"] == "learn: no surface was found" and "scores" not in kept(failed)


def test_a_row_takes_the_place_of_an_older_one_of_its_run(tmp_path):
    run = Run(Path("box"), "preview")
    for one, commit, peak in ((run, "1234abcd", 1.0), (run, "1234abcd", 2.0), (replace(run, seed=1), "1234abcd", 3.0)):
        assert keep(kept(row_of(one, commit, peak_mb=peak)), tmp_path)
    assert keep(kept(row_of(run, "5678abcd")), tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["1234abc.jsonl", "5678abc.jsonl"]
    assert [row["size"]["peak_mb"] for row in read_lines(tmp_path / "1234abc.jsonl")] == [2.0, 3.0]


@pytest.mark.parametrize("commit", ["", "1234abcd-dirty"])
def test_a_row_of_code_that_no_commit_holds_is_not_kept(commit, tmp_path):
    assert not keep(kept(row_of(Run(Path("box")), commit)), tmp_path) and not list(tmp_path.iterdir())


def test_rows_that_are_kept_at_once_are_all_kept(tmp_path):
    rows = [kept(row_of(Run(Path("box"), seed=seed))) for seed in range(12)]
    threads = [threading.Thread(target=keep, args=(row, tmp_path)) for row in rows]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sorted(row["seed"] for row in read_lines(tmp_path / "1234abc.jsonl")) == list(range(12))


def test_the_runner_keeps_each_row(tmp_path, monkeypatch):
    class Learned(Suite):
        def identify(self, runs):
            return {}

        def run_step(self, step, run, asset):
            return LEARNED if step == "learn" else SCORE

    monkeypatch.setattr(runner, "commit_now", lambda: "1234abcd")
    runs = [Run(SUZANNE_SMALL, "preview", seed=seed) for seed in (0, 1)]
    Learned(tmp_path / "out", rows=tmp_path / "rows").run_all(runs, 1)
    rows = rows_of("1234abc", tmp_path / "rows")
    assert [row["seed"] for row in rows] == [0, 1] and all(row["refinements"]["carve"] for row in rows)
    assert rows == load(tmp_path / "out")


def test_the_runner_says_that_rows_of_changed_code_are_not_kept(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(runner, "commit_now", lambda: "1234abcd-dirty")
    monkeypatch.setattr(Suite, "identify", lambda suite, runs: {})
    Suite(tmp_path, rows=tmp_path / "rows").run_all([], 1)
    assert "no commit holds this code: rows are in" in capsys.readouterr().err


def test_sources_are_commits_files_and_folders(tmp_path):
    rows, out = tmp_path / "rows", tmp_path / "out"
    one, two = (kept(row_of(Run(Path(name)), commit)) for name, commit in (("box", "aaaaaaaa"), ("bunny", "bbbbbbbb")))
    for row in (one, two):
        keep(row, rows)
    write_row(out / "rows" / "box.json", row_of(Run(Path("box")), "aaaaaaaa"))
    assert rows_of("aaaaaaa", rows) == rows_of("aaaaaaaa", rows) == rows_of(str(rows / "aaaaaaa.jsonl"), rows) == [one]
    assert rows_of(str(out), rows) == rows_of(str(out / "rows" / "box.json"), rows) == [one]
    assert rows_of("aaaaaaa+bbbbbbb", rows) == rows_of("all", rows) == rows_of(str(rows), rows) == [one, two]
    assert (
        lasting(str(out), rows) == "aaaaaaa"
        and lasting("aaaaaaaa", rows) == "aaaaaaa"
        and lasting("all", rows) == "aaaaaaa+bbbbbbb"
    )
    for source, message in (("ccccccc", "holds no rows of this commit"), (str(tmp_path / "out" / "rows"), "holds no rows")):
        with pytest.raises(SourceError, match=message):
            rows_of(source, rows)


def test_many_commits_are_one_source(tmp_path):
    """Their names together are longer than the name of a file may be."""
    commits = [f"{k:07x}" for k in range(40)]
    for k, commit in enumerate(commits):
        keep(kept(row_of(Run(Path(f"object_{k}")), commit)), tmp_path)
    many = "+".join(commits)
    assert len(many) > 255 and len(rows_of(many, tmp_path)) == 40 and lasting(many, tmp_path) == many


def test_a_branch_is_a_source(tmp_path):
    def git(*words):
        done = subprocess.run(["git", "-C", tmp_path, *words], capture_output=True, text=True, check=True)
        return done.stdout.strip()

    git("init", "--quiet", "--initial-branch", "trial")
    git("-c", "user.name=a", "-c", "user.email=a@b", "commit", "--quiet", "--allow-empty", "--message", "one")
    commit = git("rev-parse", "HEAD")
    keep(kept(row_of(Run(Path("box")), commit)), tmp_path)
    assert [row["commit"] for row in rows_of("trial", tmp_path)] == [commit[:7]] and lasting("trial", tmp_path) == commit[:7]


@pytest.mark.parametrize(("line", "message"), [("{", "line 2 is no JSON"), ('{"preset": "x"}', "line 2 is no row")])
def test_a_line_that_is_no_row_is_named(line, message, tmp_path):
    file = tmp_path / "rows.jsonl"
    file.write_text(json.dumps({"capture": "box", "preset": "preview"}) + "\n" + line + "\n")
    with pytest.raises(SourceError, match=message):
        read_lines(file)


def test_the_kept_rows_of_the_repository_are_whole_and_small():
    files = sorted(ROWS.glob("*.jsonl"))
    assert files
    for file in files:
        rows = read_lines(file)
        assert len({tuple(run_of(row).items()) for row in rows}) == len(rows), f"{file.name} holds a run twice"
        for row in rows:
            assert row.keys() >= {"commit", "date", "capture", "preset"} and (row.keys() & {"scores", "error"})
            assert "command" in row or "versions" in row, f"{file.name}: how was this made?"
            assert len(json.dumps(row)) < 4000
