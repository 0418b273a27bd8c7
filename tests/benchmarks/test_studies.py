"""The commands of the studies: what they look at before the first run, what their rows are told apart by, what they time."""

import json
import shutil
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip("fcntl", reason="the suite runs on POSIX systems")
pytest.importorskip("igl")
from benchmarks.baselines import peer_mitsuba, reference_path
from benchmarks.baselines.reference_path import COLUMNS, planned
from benchmarks.row_files import read_row, write_row
from benchmarks.studies import cluster, scaling, skipping
from blender_nep.presets import preset
from support.paths import SUZANNE_SMALL

SCORES = {"seconds": 1.0, "skipped": {}, **dict.fromkeys(skipping.ERRORS, 0.0)}


@pytest.fixture
def call(monkeypatch, tmp_path):
    """Run the command of a module with these words, and --out."""

    def called(module, *words: object) -> None:
        monkeypatch.setattr("sys.argv", ["command", *map(str, words), "--out", str(tmp_path / "out")])
        module.main()

    return called


def without(file: str, folder: Path) -> Path:
    """A copy of the small capture that lacks a file."""
    shutil.copytree(SUZANNE_SMALL, folder)
    (folder / file).unlink()
    return folder


@pytest.mark.parametrize("module", [reference_path, peer_mitsuba])
def test_an_unusable_capture_is_told_before_the_first_run(module, call, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(module, "run", lambda *_: pytest.fail("a run has begun"))
    bad = {tmp_path / "mistyped": "mistyped", without("gt_mesh.ply", tmp_path / "bare"): "gt_mesh.ply is missing"}
    bad |= {tmp_path / "again" / SUZANNE_SMALL.name: f"two captures have the name {SUZANNE_SMALL.name}"}
    shutil.copytree(SUZANNE_SMALL, tmp_path / "again" / SUZANNE_SMALL.name)
    for folder, message in bad.items():
        with pytest.raises(SystemExit) as ended:
            call(module, SUZANNE_SMALL, folder)
        assert ended.value.code == 2 and message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_mistyped_capture_of_the_study_of_scaling_is_told(call, tmp_path, capsys):
    with pytest.raises(SystemExit) as ended:
        call(scaling, "--capture", tmp_path / "mistyped")
    assert ended.value.code == 2 and "mistyped" in capsys.readouterr().err


def test_a_row_of_the_reference_is_of_its_hours_and_steps(call, tmp_path, monkeypatch):
    done = []
    monkeypatch.setattr(reference_path, "run", lambda *_: done.append("run") or dict.fromkeys(COLUMNS, 1.0) | {"steps": 9})
    for words, other in ((("--hours", 2), ("--hours", 3)), (("--steps", 9), ("--steps", 8))):
        for _ in range(2):
            call(reference_path, SUZANNE_SMALL, *words)
        for changed in (other, ()):
            with pytest.raises(SystemExit, match="something else"):
                call(reference_path, SUZANNE_SMALL, *changed)
        shutil.rmtree(tmp_path / "out")
    assert len(done) == 2


def test_a_plan_of_the_reference_is_of_its_hours_and_steps(tmp_path, monkeypatch):
    monkeypatch.setattr(reference_path, "step_seconds", lambda *_: 2.0)
    given = (None, preset("balanced"), "small")
    plan = planned(tmp_path / "plan.json", *given, 1.0, None, 0)
    assert plan["steps"] == 1800 and planned(tmp_path / "plan.json", *given, 1.0, None, 0) == plan
    for hours, steps in ((2.0, None), (1.0, 1800)):
        with pytest.raises(SystemExit, match="other hours or steps"):
            planned(tmp_path / "plan.json", *given, hours, steps, 0)
    write_row(tmp_path / "older.json", {"step_seconds": 2.0, "steps": 1800})
    with pytest.raises(SystemExit, match="other hours or steps"):
        planned(tmp_path / "older.json", *given, 1.0, None, 0)


def test_a_row_of_skipping_is_of_its_threads(call, monkeypatch):
    monkeypatch.setattr(skipping, "Job", lambda *_: SimpleNamespace(run=lambda: None, close=lambda: None))
    monkeypatch.setattr(skipping, "run", lambda *_: SCORES)
    for _ in range(2):
        call(skipping, SUZANNE_SMALL)
    with pytest.raises(SystemExit, match=r"something else \(threads\)"):
        call(skipping, SUZANNE_SMALL, "--threads", 2)


@pytest.mark.slow
def test_small_jobs_run_before_a_run_of_skipping_is_timed(call, tmp_path, monkeypatch):
    """They are whole jobs: every stage runs. Where no run is missing, there are none."""
    begun, job = [], skipping.Job

    class Recorder(job):
        def run(self) -> None:
            super().run()
            begun.append("small job")

    monkeypatch.setattr(skipping, "Job", Recorder)
    monkeypatch.setattr(skipping, "run", lambda *_: begun.append("timed") or SCORES)
    call(skipping, SUZANNE_SMALL, "--seeds", 0, 1)
    call(skipping, SUZANNE_SMALL, "--seeds", 0, 1)
    assert begun == ["small job"] * 2 + ["timed"] * 4
    rows = [read_row(file) for file in (tmp_path / "out").glob("*.json")]
    assert len(rows) == 4 and {row["threads"] for row in rows} == {1} and "stage_1" not in json.dumps(rows)


def test_the_drivers_cpu_seconds_are_without_those_of_the_watch(monkeypatch):
    """The watch works for half a second of CPU time. The driver only sleeps."""

    def busy(_):
        start = time.thread_time()
        while time.thread_time() - start < 0.5:
            pass
        looked.append(True)
        return []

    looked: list[bool] = []
    monkeypatch.setattr(cluster.psutil, "process_iter", busy)
    with cluster.CpuWatch() as watch:
        while not looked:
            time.sleep(0.05)
    assert 0 <= watch.driver_seconds < 0.25
