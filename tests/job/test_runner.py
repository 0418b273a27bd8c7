"""The job: stages in order, events, checkpoints, stopping and resuming. The stages here know the answer (ball_stages)."""

from __future__ import annotations

import io
import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import OpenEXR
import pytest
import torch

from backend.scene_io.capture_files import read_frames, with_exposures
from blender_nep import checkpoints
from blender_nep.capture.exposure import Exposures
from blender_nep.checkpoints import Checkpoint, load_state, save_state
from blender_nep.errors import LearningError, Stopped
from blender_nep.job import preparation
from blender_nep.job import runner as job
from blender_nep.job.events import Events
from blender_nep.job.stage_names import StageName
from blender_nep.job.timeline import Timeline, time_text
from blender_nep.presets import preset
from blender_nep.shading.unseen_light import UnseenLight
from blender_nep.stop_request import StopRequest
from support.ball_stages import BallStages
from support.captures import CENTER, RADIUS
from support.paths import TESTS


@pytest.fixture
def start(make_capture, tmp_path):
    """start(stages, stop=..., **settings) runs a job; returns exit code and events. start.out is the asset."""
    folder = make_capture(masks=True).folder

    def run(stages, stop=None, **keywords):
        protocol = io.StringIO()
        settings = job.Settings(**({"capture": folder, "out": run.out, "preset": preset("preview")} | keywords))
        code = job.run(settings, Events(protocol, io.StringIO()), stop or StopRequest(), stages)
        return code, [json.loads(line) for line in protocol.getvalue().splitlines()]

    run.out = tmp_path / "asset"
    run.folder = folder
    return run


def test_a_job_ends_with_an_asset_and_tells_how_far_it_is(start):
    stages = BallStages(steps=4)
    code, events = start(stages)
    assert code == 0 and stages.entered == ["fields_learning", "surface", "material_learning"]
    assert events[-1] == {"event": "done", "asset": str(start.out)}
    progress = [e for e in events if e["event"] == "progress"]
    assert [e for n, e in enumerate(progress) if n == 0 or e["stage"] != progress[n - 1]["stage"]] != []
    assert list(dict.fromkeys(e["stage"] for e in progress)) == list(StageName)
    fractions = [e["fraction"] for e in progress]
    assert fractions == sorted(fractions) and fractions[0] == 0 and fractions[-1] == 1
    assert all(e["eta_s"] >= 0 for e in progress) and progress[-1]["eta_s"] < 1
    assert {"step", "steps", "fraction", "eta_s", "loss"} <= set(progress[0])
    report = json.loads((start.out / "report.json").read_text())
    assert report["preset"] == "preview" and report["seed"] == 0 and report["capture"]["views"] == 6
    assert set(report["seconds"]) == set(StageName) and report["peak_memory_mb"] > 10
    assert report["versions"]["torch"] == torch.__version__
    convex = "the object is convex"
    assert report["skipped"] == {"nothing": "a test", "indirect light": convex}
    assert report["losses"]["fields_learning"] == pytest.approx(0.25)


def test_what_the_scene_needs_is_told_before_it_is_done_and_stands_in_the_report(start):
    class Asked(BallStages):
        def learn_fields(self, *arguments, **keywords):
            found = super().learn_fields(*arguments, **keywords)
            found.report |= {"steps": 60, "of_steps": 90}
            return found

        def learn_materials(self, given, *how):
            asked.append(given.preset.levels)
            found = super().learn_materials(given, *how)
            found.report |= {
                "skipped": dict.fromkeys(("material boundaries", "fine textures"), "a reason"),
                "seconds_saved": {"fine textures": 3.14159},
            }
            return found

    asked: list[int] = []
    _, events = start(Asked())
    names = [e["event"] if e["event"] != "progress" else e["stage"] for e in events]
    told = [e["lines"] for e in events if e["event"] == "scene"]
    assert names.index("scene") < names.index("fields_learning") and len(told) == 5, told
    assert "Masks are there and are used." in told[0]
    left_out = "Left out: reflections of the object in itself, because the object is convex."
    assert left_out in told[2] and left_out not in told[1]
    assert any(line.startswith("Left out: the rest of learning") for line in told[1])
    assert told[-1][-1] == ("Left out: boundaries between materials, fine textures, because a reason (saves about 3 s).")
    report = json.loads((start.out / "report.json").read_text())
    assert report["scene"]["photos"]["masks"] and report["scene"]["surface"]["self_visibility"] == 0
    assert report["scene"]["sentences"] == [*told[0][:4], "The object is convex."]
    assert report["skipped_seconds"] == {
        "fine textures": 3.14,
        "further steps of both fields": pytest.approx(report["seconds"]["fields_learning"] / 2, abs=0.02),
    }
    assert "seconds_saved" not in report["stages"]["material_learning"]
    start(Asked(), overwrite=True, preset=replace(preset("preview"), skip_needless=False))
    assert asked == [0, preset("preview").material.levels]


@pytest.mark.parametrize("even", [True, False])
def test_photos_of_differing_exposure_are_evened_out_and_the_report_says_by_how_much(start, monkeypatch, even):
    class Looked(BallStages):
        def learn_fields(self, given, *how):
            seen.append(given.rays.gain)
            return super().learn_fields(given, *how)

    seen: list[torch.Tensor | None] = []
    gain = torch.tensor([2.0, 0.5, 1, 1, 1, 1])[:, None].expand(6, 3)
    monkeypatch.setattr(preparation, "find_exposures", lambda rays: Exposures(gain, "a doubt"))
    start(Looked(), preset=replace(preset("preview"), even_exposure=even))
    report = json.loads((start.out / "report.json").read_text())
    said = "The photos differ in exposure (by up to 2.0 stops), which is evened out." in report["scene"]["sentences"]
    assert (seen[0] is not None) == said == ("photo_gains" in report["capture"]) == even
    assert report["warnings"] == (["a doubt"] if even else [])
    if even:
        frames = with_exposures(read_frames(start.folder), start.out)
        assert [frame.gain for frame in frames] == [tuple(g) for g in gain.tolist()]
        assert with_exposures(frames[:3], start.out) == frames[:3], "made from other photos"
    assert all(frame.gain == (1, 1, 1) for frame in with_exposures(read_frames(start.folder), start.folder))


def test_masks_ignored_are_reported_as_skipped(start):
    start(BallStages(), use_masks=False)
    report = json.loads((start.out / "report.json").read_text())
    assert report["skipped"]["mask term"] == "masks are ignored (--masks ignore)"


@pytest.mark.parametrize("coverage", [1.0, 0.0])
def test_the_light_that_no_photo_shows_is_in_the_environment_map(start, coverage):
    class Lit(BallStages):
        def learn_fields(self, *arguments, **keywords):
            fields = super().learn_fields(*arguments, **keywords)
            fields.environment.coverage = coverage
            return fields

        def learn_materials(self, *arguments, **keywords):
            materials = super().learn_materials(*arguments, **keywords)
            materials.unseen = UnseenLight(8, 4.0, "cpu")
            materials.unseen.radiance += 2.0
            return materials

    assert start(Lit())[0] == 0
    light = OpenEXR.File(str(start.out / "environment.exr")).channels()["RGB"].pixels
    assert np.allclose(light, 0.5 + 2.0 * (1 - coverage))


def test_clean_removes_checkpoints(start):
    assert start(BallStages(), clean=True)[0] == 0
    assert not (start.out / "checkpoints").exists() and (start.out / "report.json").exists()


def test_an_asset_is_not_overwritten_by_accident(start):
    assert start(BallStages())[0] == 0
    before = (start.out / "report.json").stat().st_mtime_ns
    code, events = start(BallStages())
    assert code == 2 and "already holds an asset" in events[-1]["message"] and "--overwrite" in events[-1]["hint"]
    assert (start.out / "report.json").stat().st_mtime_ns == before
    assert start(BallStages(), overwrite=True)[0] == 0
    assert (start.out / "report.json").stat().st_mtime_ns > before


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


@pytest.mark.parametrize(("margin", "told"), [(0.01, True), (-0.02, True), (0.2, False), (None, False)])
def test_doubt_about_metal_is_told(start, margin, told):
    class Doubtful(BallStages):
        def learn_materials(self, *arguments, **keywords):
            found = super().learn_materials(*arguments, **keywords)
            found.report["metal_or_not_margin"] = margin
            return found

    code, events = start(Doubtful())
    assert code == 0 and any("--metal" in e["message"] for e in events if e["event"] == "warning") == told


def test_a_torn_result_does_its_stage_again(start):
    stop = StopRequest()
    start(BallStages(on_step=lambda r, s: stop.request("test") if r == "material_learning" else None), stop)
    done = start.out / "checkpoints" / "fields_learning.done.pt"
    done.write_bytes(done.read_bytes()[:100])
    stages = BallStages()
    code, events = start(stages, resume=True)
    assert code == 0 and stages.entered[0] == "fields_learning"
    assert any("damaged" in e["message"] for e in events if e["event"] == "warning")


def test_errors_have_one_message_and_their_traceback_in_the_log(start):
    code, events = start(BallStages(fail=LearningError("no surface was found", "Use masks.")))
    assert code == 6 and events[-1] == {
        "event": "error",
        "code": 6,
        "message": "no surface was found",
        "hint": "Use masks.",
    }
    code, events = start(BallStages(fail=ZeroDivisionError("division by zero")), overwrite=True)
    assert code == 1 and events[-1]["message"] == "unexpected ZeroDivisionError: division by zero"
    assert "Traceback" in (start.out / "log.txt").read_text() and "Traceback" not in json.dumps(events)
    code, events = start(BallStages(fail=MemoryError()), overwrite=True)
    assert code == 1 and events[-1]["message"] == "out of memory"
    assert not (start.out / "report.json").exists()


def test_a_full_disk_is_said(start, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(checkpoints.torch, "save", full)
    code, events = start(BallStages())
    assert code == 5 and "disk is full" in events[-1]["message"]
    assert not (start.out / "report.json").exists()


def test_a_log_that_cannot_be_written_does_not_hide_the_error(tmp_path):
    class Full(io.StringIO):
        def write(self, text):
            raise OSError(28, "No space left on device")

    human = io.StringIO()
    events = Events(None, human)
    events._log = Full()
    events.error(5, "the disk is full", "Free some space.")
    events.close()
    assert "the disk is full" in human.getvalue()


def test_states_survive_the_disk(tmp_path):
    state = {
        "array": np.arange(6, dtype=np.float16).reshape(2, 3),
        "tensor": torch.ones(2, dtype=torch.int64),
        "nested": [1, (2.5, "x", None), {"generator": torch.Generator().manual_seed(4).get_state()}],
        3: np.float32(0.5),
    }
    save_state(tmp_path / "a.pt", state)
    back = load_state(tmp_path / "a.pt")
    np.testing.assert_array_equal(back["array"], state["array"])
    assert back["array"].dtype == np.float16 and torch.equal(back["tensor"], state["tensor"])
    assert back["nested"][:2] == [1, (2.5, "x", None)] and back[3] == 0.5
    assert torch.equal(back["nested"][2]["generator"], state["nested"][2]["generator"])
    assert [p.name for p in tmp_path.iterdir()] == ["a.pt"]


def test_a_checkpoint_file_runs_no_code(tmp_path):
    class Evil:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "owned"),)

    torch.save(Evil(), tmp_path / "a.pt")
    with pytest.raises(ValueError, match="damaged"):
        load_state(tmp_path / "a.pt")
    assert not (tmp_path / "owned").exists()


def test_a_torn_checkpoint_falls_back_to_the_one_before(tmp_path):
    warnings = []
    first = Checkpoint(tmp_path, "stage", StopRequest(), warnings.append)
    first.save({"step": 1})
    first.save({"step": 2})
    assert Checkpoint(tmp_path, "stage", StopRequest(), warnings.append).load() == {"step": 2}
    first.path.write_bytes(first.path.read_bytes()[:200])
    assert Checkpoint(tmp_path, "stage", StopRequest(), warnings.append).load() == {"step": 1}
    assert len(warnings) == 1 and "damaged" in warnings[0]
    first.previous.write_bytes(b"")
    assert Checkpoint(tmp_path, "stage", StopRequest(), warnings.append).load() is None


def test_a_checkpoint_is_due_every_fifteen_seconds_and_counts_time(tmp_path):
    now = [0.0]
    stop = StopRequest()
    checkpoint = Checkpoint(tmp_path, "stage", stop, print, clock=lambda: now[0])
    now[0] = 14.9
    assert not checkpoint.due()
    now[0] = 15.0
    assert checkpoint.due()
    checkpoint.save({})
    assert not checkpoint.due()
    stop.request("test")
    assert checkpoint.due() and checkpoint.stopping
    checkpoint.raise_if_stopped(saves=True)  # not saved yet: goes on
    checkpoint.save({})
    with pytest.raises(Stopped):
        checkpoint.raise_if_stopped(saves=True)
    again = Checkpoint(tmp_path, "stage", StopRequest(), print, clock=lambda: now[0])
    again.load()
    now[0] += 2
    assert again.seconds() == pytest.approx(17)


def test_standard_input_stops_by_command_and_by_its_end():
    for message, reason in ((b'nonsense\n{"cmd": "stop"}\n', "stop command"), (b"", "closed")):
        read, write = os.pipe()
        stop = StopRequest()
        stop.watch(read)
        os.write(write, message or b"\n")
        if not message:
            os.close(write)
        for _ in range(1000):
            if stop.requested:
                break
            time.sleep(0.01)
        assert stop.requested and reason in stop.reason


def test_time_left_follows_the_measured_pace():
    now = [0.0]
    line = Timeline({"a": 100.0, "b": 300.0}, clock=lambda: now[0])
    line.enter("a")
    assert line.at(0.0) == (0.0, 400.0)
    now[0] = 20.0  # twice as fast as guessed: 60 % of a in 20 s would be 33 s, here 40 %
    fraction, eta = line.at(0.4)
    assert fraction == pytest.approx(0.1) and eta == pytest.approx(30 + 300 * 0.5)
    now[0] = 50.0
    line.leave()
    line.enter("b")
    assert line.at(0.0)[1] == pytest.approx(150)


def test_time_left_of_a_resumed_stage_counts_only_its_own_steps():
    now = [0.0]
    line = Timeline({"a": 100.0}, clock=lambda: now[0])
    line.enter("a")
    line.begin_at(0.5)
    now[0] = 10.0
    assert line.at(0.6)[1] == pytest.approx(40)


def test_events_are_json_whatever_they_hold():
    protocol, human = io.StringIO(), io.StringIO()
    events = Events(protocol, human)
    events.progress("r", 1, 10, 0.1, float("inf"), float("nan"), extra=np.float32(2))
    events.warning("twice")
    events.warning("twice")
    lines = [json.loads(line) for line in protocol.getvalue().splitlines()]
    assert lines[0]["eta_s"] is None and lines[0]["loss"] is None and lines[0]["extra"] == 2
    assert [line["event"] for line in lines] == ["progress", "warning"]
    assert human.getvalue().count("twice") == 1


def test_a_reader_that_went_away_does_not_end_the_job():
    read, write = os.pipe()
    os.close(read)
    events = Events(os.fdopen(write, "w", buffering=1), io.StringIO())
    events.emit("warning", message="x")
    events.emit("warning", message="y")
    assert time_text(75) == "1:15" and time_text(3725) == "1:02:05"


SLOW_JOB = """
import sys, time
from pathlib import Path
sys.path.insert(0, {tests!r})
from support.ball_stages import BallStages
from blender_nep.job import runner as job
from blender_nep.checkpoints import Checkpoint
from blender_nep.stop_request import StopRequest
from blender_nep.job.events import Events
from blender_nep.presets import preset
from blender_nep.shading.unseen_light import UnseenLight
Checkpoint.interval = 0.01
settings = job.Settings(Path({capture!r}), Path({out!r}), preset("preview"))
job.run(settings, Events(), StopRequest(), BallStages(steps=150, on_step=lambda stage, step: time.sleep(0.005)))
"""


@pytest.mark.parametrize("file", ["fields_learning.previous.pt", "surface.done.pt", "material_learning.pt"])
def test_a_killed_process_is_resumed(start, file):
    """kill -9 as soon as a file appears; the run then goes on from it and gives an asset."""
    script = SLOW_JOB.format(tests=str(TESTS), capture=str(start.folder), out=str(start.out))
    process = subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    wait_until = start.out / "checkpoints" / file
    while not wait_until.exists() and process.poll() is None:
        time.sleep(0.001)
    process.kill()
    process.communicate()
    assert wait_until.exists() and not (start.out / "report.json").exists()
    stages = BallStages(steps=150)
    code, _ = start(stages, resume=True)
    assert code == 0 and (start.out / "report.json").exists()
    expected = {"fields_learning.previous.pt": "fields_learning"}.get(file, "material_learning")
    assert stages.entered[0] == expected
    if "done" not in file:
        assert stages.started_at[expected] > 0
