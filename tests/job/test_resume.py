"""Stopping, killing and resuming a job, and the runs that are refused. The stages here know the answer (ball_stages)."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from blender_nep.capture import load_capture
from blender_nep.job.folders.run_folder import FORMAT, fingerprint
from blender_nep.presets import preset
from blender_nep.stop_request import StopRequest
from support.ball_stages import BallStages
from support.captures import CENTER, RADIUS
from support.paths import TESTS


@pytest.mark.parametrize("stage", ["fields_learning", "material_learning"])
def test_a_stop_writes_a_checkpoint_and_resume_goes_on_there(start, stage):
    stop = StopRequest()
    stages = BallStages(steps=6, on_step=lambda r, step: stop.request("test") if (r, step) == (stage, 3) else None)
    code, events = start(stages, stop)
    assert code == 7 and events[-1]["code"] == 7 and "--resume" in events[-1]["hint"]
    assert not (start.out / "report.json").exists()
    assert start(BallStages())[0] == 2  # neither resumed nor overwritten: refused
    stages = BallStages(steps=6)
    code, events = start(stages, resume=True)
    assert code == 0 and stages.started_at[stage] == 3
    assert ("fields_learning" in stages.entered) == (stage == "fields_learning")
    report = json.loads((start.out / "report.json").read_text())
    assert report["resumed_stages"] == ([] if stage == "fields_learning" else ["fields_learning", "surface"])


def test_sigterm_is_a_stop(start):
    def on_step(stage, step):
        if step == 2:
            os.kill(os.getpid(), signal.SIGTERM)

    stop = StopRequest()
    with stop.signals():
        code, events = start(BallStages(on_step=on_step), stop)
    assert code == 7 and "SIGTERM" in events[-1]["message"]
    assert start(BallStages(), resume=True)[0] == 0


def test_resume_refuses_other_settings(start):
    stop = StopRequest()
    start(BallStages(on_step=lambda r, s: stop.request("test")), stop)
    for other, name in (
        ({"seed": 1}, "seed"),
        ({"preset": preset("quality")}, "preset"),
        ({"preset": replace(preset("preview"), material=replace(preset("preview").material, metallic=(1.0,)))}, "metal"),
        ({"use_masks": False}, "masks"),
        ({"sphere": (CENTER, RADIUS)}, "object bounds"),
    ):
        code, events = start(BallStages(), resume=True, **other)
        assert code == 2 and name in events[-1]["message"]
    (start.folder / "transforms.json").write_text((start.folder / "transforms.json").read_text() + "\n")
    code, events = start(BallStages(), resume=True)
    assert code == 2 and "capture" in events[-1]["message"]


def contents(folder: Path) -> dict[str, tuple[int, bytes]]:
    """{path: (time of the last change, bytes)} of all files."""
    files = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): (path.stat().st_mtime_ns, path.read_bytes()) for path in files}


def change(path: Path, what) -> None:
    """Rewrite a JSON file as what(content) says."""
    path.write_text(json.dumps(what(json.loads(path.read_text()))))


def of_format(number: int):
    """Rewrites what identifies a run as that of another version."""
    return lambda run: run | {"format": number}


@pytest.mark.parametrize("number", [FORMAT - 1, FORMAT + 1, None])
def test_a_run_of_another_version_is_refused_and_left_alone(start, number):
    start(BallStages(on_step=lambda r, s: stop.request("test")), stop := StopRequest())
    change(start.out / "checkpoints" / "run.json", of_format(number))
    before = contents(start.out)
    code, events = start(stages := BallStages(), resume=True)
    assert code == 2 and not stages.entered and contents(start.out) == before
    assert "is of another version" in events[-1]["message"] and "--overwrite" in events[-1]["hint"]
    assert events[-1]["name"] == "usage.other_version" and events[-1]["values"] == {"folder": str(start.out)}
    assert start(BallStages(), overwrite=True)[0] == 0


@pytest.mark.parametrize(
    ("older", "name"),
    [
        (lambda report: report | {"fingerprint": report["fingerprint"] | {"format": 2}}, "usage.other_version"),
        (lambda report: {k: v for k, v in report.items() if k != "fingerprint"}, "usage.other_version"),
        (lambda report: report | {"fingerprint": 7}, "usage.report_damaged"),
        (lambda report: [], "usage.report_damaged"),
    ],
    ids=["format 2", "without format", "no fingerprint", "no report"],
)
def test_an_asset_of_another_version_is_refused_and_left_alone(start, older, name):
    assert start(BallStages())[0] == 0
    change(start.out / "report.json", older)
    before = contents(start.out)
    code, events = start(stages := BallStages(), resume=True)
    assert code == 2 and not stages.entered and contents(start.out) == before
    assert events[-1]["name"] == name and "--overwrite" in events[-1]["hint"]
    assert start(BallStages(), overwrite=True)[0] == 0


def test_checkpoints_of_an_unknown_run_are_refused_and_kept(start):
    start(BallStages(on_step=lambda r, s: stop.request("test")), stop := StopRequest())
    (start.out / "checkpoints" / "run.json").unlink()
    before = contents(start.out)
    assert "checkpoints/fields_learning.pt" in before
    code, events = start(stages := BallStages(), resume=True)
    assert code == 2 and not stages.entered and contents(start.out) == before
    assert events[-1]["name"] == "usage.unknown_run" and "run.json" in events[-1]["message"]
    for path in (start.out / "checkpoints").glob("*.pt"):
        path.unlink()
    assert start(BallStages(), resume=True)[0] == 0, "a run that was killed before its first checkpoint"


def test_a_damaged_description_is_told_and_the_run_starts_again(start):
    start(BallStages(on_step=lambda r, s: stop.request("test")), stop := StopRequest())
    (start.out / "checkpoints" / "run.json").write_text('{"format": 3')
    code, events = start(stages := BallStages(), resume=True)
    assert code == 0 and stages.started_at["fields_learning"] == 0
    assert [e["code"] for e in events if e["event"] == "warning"] == ["job.run_file_damaged"]


def test_a_given_sphere_counts_and_a_resume_needs_it(start):
    stop = StopRequest()
    sphere = ((CENTER[0] + 0.1, CENTER[1], CENTER[2]), 0.7)
    start(BallStages(on_step=lambda r, s: stop.request("test")), stop, sphere=sphere)
    for other in (None, (sphere[0], 0.71)):
        code, events = start(BallStages(), resume=True, sphere=other)
        assert code == 2 and "object bounds" in events[-1]["message"]
    assert start(BallStages(), resume=True, sphere=sphere)[0] == 0
    report = json.loads((start.out / "report.json").read_text())["capture"]
    assert report["object_center"] == pytest.approx(sphere[0]) and report["object_radius"] == 0.7
    assert report["bounds_source"] == "options" and report["folder"] == str(start.folder)
    code, events = start(BallStages(), overwrite=True, sphere=(CENTER, 2.6))
    assert code == 4 and "stand inside" in events[-1]["message"]


def test_resume_of_nothing_starts_and_of_a_complete_asset_ends(start):
    stages = BallStages()
    assert start(stages, resume=True)[0] == 0 and stages.entered
    stages = BallStages()
    code, events = start(stages, resume=True)
    assert code == 0 and stages.entered == [] and events[-1]["event"] == "done"
    code, events = start(stages, resume=True, seed=5)
    assert code == 2 and "seed" in events[-1]["message"]


def test_a_torn_result_does_its_stage_again(start):
    stop = StopRequest()
    start(BallStages(on_step=lambda r, s: stop.request("test") if r == "material_learning" else None), stop)
    done = start.out / "checkpoints" / "fields_learning.done.pt"
    done.write_bytes(done.read_bytes()[:100])
    stages = BallStages()
    code, events = start(stages, resume=True)
    assert code == 0 and stages.entered[0] == "fields_learning"
    assert "job.result_damaged" in [e["code"] for e in events if e["event"] == "warning"]


SLOW_JOB = """
import sys, time
from pathlib import Path
sys.path.insert(0, {tests!r})
from support.ball_stages import BallStages
from blender_nep.job import runner as job
from blender_nep.checkpoints import Checkpoint
from blender_nep.stop_request import StopRequest
from blender_nep.job.reporting.events import Events
from blender_nep.presets import preset
from blender_nep.shading.unseen_light import UnseenLight
Checkpoint.interval = 0.01
settings = job.Settings(Path({capture!r}), Path({out!r}), preset("preview"))
job.run(settings, Events(), StopRequest(), BallStages(steps=150, on_step=lambda stage, step: time.sleep(0.005)))
"""


@pytest.mark.parametrize(
    "file", ["fields_learning.previous.pt", pytest.param("surface.done.pt", marks=pytest.mark.slow), "material_learning.pt"]
)
def test_a_killed_process_is_resumed(start, file):
    """kill -9 as soon as a file appears; the run then goes on from it and gives an asset."""
    script = SLOW_JOB.format(tests=str(TESTS), capture=str(start.folder), out=str(start.out))
    awaited, deadline = start.out / "checkpoints" / file, time.monotonic() + 300
    with open(start.out.with_name("stderr.txt"), "w") as errors:  # a pipe that nobody reads would block the job when full
        process = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.DEVNULL, stderr=errors)
    try:
        while not awaited.exists() and process.poll() is None and time.monotonic() < deadline:
            time.sleep(0.001)
    finally:
        process.kill()
        process.wait()
    assert awaited.exists(), start.out.with_name("stderr.txt").read_text()[-2000:]
    assert not (start.out / "report.json").exists()
    stages = BallStages(steps=150)
    code, _ = start(stages, resume=True)
    assert code == 0 and (start.out / "report.json").exists()
    expected = {"fields_learning.previous.pt": "fields_learning"}.get(file, "material_learning")
    assert stages.entered[0] == expected
    if "done" not in file:
        assert stages.started_at[expected] > 0


def test_photos_on_another_drive_have_a_fingerprint(make_capture, monkeypatch):
    """So it may be on Windows, where no relative path leads from one drive to another."""

    def refuse(path, start):
        raise ValueError("path is on mount 'D:', start on mount 'C:'")

    capture = load_capture(make_capture().folder)
    same = fingerprint(capture, preset("preview"), 0, True, None)
    monkeypatch.setattr("os.path.relpath", refuse)
    apart = fingerprint(capture, preset("preview"), 0, True, None)
    assert {key for key in same if same[key] != apart[key]} == {"capture"}
