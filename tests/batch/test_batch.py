"""A whole batch, with jobs that are played: what ends how, what is tried again, and what a second start does."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading

import psutil
import pytest

from blender_nep.batch import runner
from blender_nep.batch.progress import BatchProgress
from blender_nep.batch.runner import Batch
from blender_nep.batch.settings import BatchSettings
from blender_nep.batch.state import ObjectState
from blender_nep.batch.workers.machine import OUT_OF_JOB, jobs_in
from blender_nep.batch.workers.needs import Needs
from blender_nep.batch.workers.scheduler import Scheduler
from blender_nep.job.folders import job_folder
from blender_nep.job.reporting.events import Events
from blender_nep.presets import preset
from blender_nep.stop_request import StopRequest
from support.paths import ROOT
from support.waiting import wait_until

WHOLE = ["0", "1", "2", "3"]


def test_assets_of_all_and_one_failure_that_stops_nobody(batch):
    for name in ("a", "b", "c"):
        batch.add(name, "refuse" if name == "b" else "")
    code, events = batch.run()
    found = batch.objects()
    assert code == 9 and {name: one["state"] for name, one in found.items()} == {"a": "done", "b": "failed", "c": "done"}
    assert "Traceback" not in (batch.out / "log.txt").read_text(), "a failed object is no failure of the batch"
    assert events[0]["event"] == "batch" and events[0]["objects"] == 3
    assert events[-1]["code"] == 9 and events[-1]["values"] == {"names": ["b"], "objects": 3}
    assert found["b"]["error"]["message"] == "the photos are no good" and found["b"]["attempts"] == 1
    assert found["a"]["warnings"][0]["code"] == "capture.few_photos" and found["a"]["size"] == {"photos": 6, "pixels": 384}
    assert "a       done" in batch.said and "80 faces, 2 materials" in batch.said and "do something" in batch.said
    states = [(event["name"], event["state"]) for event in events if event["event"] == "object"]
    assert {("a", "running"), ("a", "done"), ("b", "failed")} <= set(states)


def test_all_done_is_code_0(batch):
    batch.add("a")
    code, events = batch.run()
    progress = [event for event in events if event["event"] == "progress"]
    assert progress[-1]["fraction"] == 1 and progress[-1]["step"] == progress[-1]["steps"] == 1
    assert code == 0 and events[-1] == {"event": "done", "asset": str(batch.out)}
    assert batch.content()["format"] == 1 and batch.content()["preset"] == "preview"


def test_the_gallery_shows_all_objects(batch):
    for name in ("a", "b"):
        batch.add(name, "refuse" if name == "b" else "")
    batch.run()
    page = (batch.out / "index.html").read_text(encoding="utf-8")
    assert "the photos are no good" in page and "do something" in page and 'href="a/' in page


def test_a_gallery_that_cannot_be_written_ends_no_batch(batch):
    batch.add("a")
    (batch.out / "index.html").mkdir(parents=True)
    (batch.out / "batch.lock").touch()  # of an earlier batch
    code, events = batch.run()
    assert code == 0 and [event["code"] for event in events if event["event"] == "warning"].count("batch.no_gallery") == 1


def test_a_broken_capture_fails_without_a_job(batch):
    (batch.add("a") / "images/003.png").write_bytes(b"no photo")
    assert batch.run()[0] == 9
    one = batch.objects()["a"]
    assert one["state"] == "failed" and "003.png" in one["error"]["message"] and one["attempts"] == 0
    assert not (batch.out / "a").exists() and batch.said.count("a: failed") == 1


@pytest.mark.parametrize(
    ("plays", "state", "attempts"), [("crash 1", "done", 2), ("crash 9", "failed", 2), ("short 1", "done", 2)]
)
def test_a_killed_job_is_tried_again_once_from_its_checkpoint(batch, plays, state, attempts):
    batch.add("a", plays)
    batch.run()
    one = batch.objects()["a"]
    assert (one["state"], one["attempts"]) == (state, attempts)
    assert batch.steps("a") == (WHOLE if state == "done" else WHOLE[:2])
    assert (state == "done") or (one["error"]["name"] == "unexpected.job_killed" and "SIGKILL" in one["error"]["message"])


def test_memory_that_was_short_is_promised_more(batch):
    batch.add("a", "short 1")
    _, events = batch.run()
    promised = [
        event["promised_memory_mb"] for event in events if event["event"] == "object" and event["state"] == "running"
    ]
    assert promised[1] == pytest.approx(1.5 * promised[0], rel=0.01)


def test_jobs_on_a_graphics_card_are_promised_more(batch, monkeypatch):
    batch.add("vase")
    batch.run(device="cpu")
    promised = batch.objects()["vase"]["promised_memory_mb"]
    monkeypatch.setattr("torch.cuda.is_available", lambda: True)
    for device, more in (("auto", True), ("cuda", True), ("cpu", False)):
        assert batch.run(device=device, overwrite=True)[0] == 0
        assert (batch.objects()["vase"]["promised_memory_mb"] > promised + 1000) == more


@pytest.mark.parametrize("played", ["cpu", "cuda"])
def test_objects_of_another_device_do_not_correct_the_promises(batch, monkeypatch, played):
    """The played jobs need less memory than predicted. Eight of them lower the promises, if the device is the same."""
    monkeypatch.setenv("NEP_PLAYED_DEVICE", played)
    for k in range(8):
        batch.add(f"vase{k}")
    batch.run(device="cpu")
    batch.add("last")
    monkeypatch.setattr("torch.cuda.is_available", lambda: True)
    batch.run(device="cuda")
    fresh = Needs(preset("preview"), on_card=True).memory_mb(batch.objects()["last"]["size"], False)
    assert (batch.objects()["last"]["promised_memory_mb"] < 0.9 * fresh) == (played == "cuda")


def test_on_a_cluster_auto_is_the_cpu(batch):
    """What a task of Ray has not asked for, other tasks may use, too."""
    for ray, device, handed in ((None, "auto", "auto"), ("auto", "auto", "cpu"), ("auto", "cuda", "cuda")):
        settings = BatchSettings((), batch.out, device=device, ray=ray)
        job = Batch(settings, Events(), StopRequest())._job(ObjectState("vase", "vase", False), 1, 100.0)
        assert job.options[job.options.index("--device") + 1] == handed
        assert job.gpus == (device == "cuda")


def test_a_graphics_card_that_is_missing_is_told_before_any_job(batch, monkeypatch):
    batch.add("vase")
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    code, events = batch.run(device="cuda")
    assert code == 2 and events[-1]["name"] == "usage.no_cuda" and not batch.out.exists()


def test_a_second_start_does_only_what_is_left(batch):
    batch.add("a")
    bad = batch.add("b", "refuse")
    assert batch.run()[0] == 9
    (bad / "plays").unlink()
    batch.add("c")
    assert batch.run()[0] == 0  # the played engine fails if it is started for an asset that is complete
    assert [batch.steps(name) for name in "abc"] == [WHOLE] * 3
    assert batch.objects()["a"]["attempts"] == 1 and batch.objects()["b"]["attempts"] == 2
    assert batch.run(captures=())[0] == 0


def test_an_asset_that_was_removed_is_made_again(batch):
    batch.add("a")
    batch.run()
    (batch.out / "a/report.json").unlink()
    (batch.out / "a/checkpoints/fields_learning.pt").unlink()
    assert batch.run()[0] == 0 and batch.steps("a") == WHOLE * 2


def stopped_run(batch, request_stop, **arguments):
    """Run a batch that is asked to stop when its job "a" waits; (exit code, events).

    It is asked even if that job never waits, because the batch would run for ever.
    """
    waited = []

    def ask() -> None:
        try:
            wait_until((batch.out / "a/waiting").exists)
            waited.append(True)
        finally:
            request_stop()

    thread = threading.Thread(target=ask)
    thread.start()
    ended = batch.run(**arguments)
    thread.join()
    assert waited, "the job did not come to its wait"
    return ended


def test_a_stop_leaves_checkpoints_and_the_next_start_goes_on(batch):
    slow, _ = batch.add("a", "slow"), batch.add("b", "slow")
    stop = StopRequest()
    code, events = stopped_run(batch, lambda: stop.request("test"), stop=stop, workers=1)
    found = batch.objects()
    assert code == 7 and events[-1]["name"] == "stopped.batch" and events[-1]["values"]["left"] == 2
    assert found["a"]["state"] == "stopped" and found["b"]["state"] == "waiting" and found["b"]["attempts"] == 0
    (slow / "go").touch()
    (batch.captures / "b/go").touch()
    assert batch.run()[0] == 0 and batch.steps("a") == batch.steps("b") == WHOLE


def test_a_file_in_its_folder_stops_the_batch_but_no_next_start(batch):
    slow = batch.add("a", "slow")
    code, events = stopped_run(batch, (batch.out / "batch.stop").touch)
    assert code == 7 and events[-1]["values"] == {"reason": "stop file", "left": 1}
    (slow / "go").touch()
    assert batch.run()[0] == 0 and batch.steps("a") == WHOLE


@pytest.mark.parametrize(("error", "code"), [(KeyboardInterrupt(), 7), (ZeroDivisionError("a bug"), 1)])
def test_no_object_is_left_running_when_the_batch_breaks_off(batch, monkeypatch, error, code):
    """As after a second Ctrl-C."""
    tick = BatchProgress.tick

    def tick_or_break(progress):
        if any(one.eta_s is not None for one in progress._work):
            raise error
        tick(progress)

    for name in ("a", "b"):
        batch.add(name, "slow")
    with monkeypatch.context() as broken:
        broken.setattr(BatchProgress, "tick", tick_or_break)
        assert batch.run(workers=1)[0] == code and not jobs_in(batch.out)
    one, other = batch.objects().values()
    assert (one["state"], one["stage"], one["eta_s"]) == ("stopped", None, None) and other["state"] == "waiting"
    assert "Start blender-nep batch again to go on" in (batch.out / "index.html").read_text(encoding="utf-8")
    for name in ("a", "b"):
        (batch.captures / name / "go").touch()
    assert batch.run()[0] == 0 and batch.steps("a") == WHOLE


def test_a_deaf_job_is_killed(batch, monkeypatch):
    monkeypatch.setattr("blender_nep.batch.workers.job_process._LONGEST_STOP_S", 0.1)
    batch.add("a", "deaf")
    stop = StopRequest()
    code, _ = stopped_run(batch, lambda: stop.request("test"), stop=stop)
    assert code == 7 and batch.objects()["a"]["state"] == "stopped"


def test_other_settings_in_the_same_folder_are_refused(batch):
    batch.add("a")
    batch.run()
    before = (batch.out / "batch.json").read_bytes()
    code, events = batch.run(preset="balanced", seed=3)
    assert code == 2 and events[-1]["name"] == "usage.other_batch" and "--preset preview" in events[-1]["message"]
    assert (batch.out / "batch.json").read_bytes() == before
    assert batch.run(preset="balanced", overwrite=True)[0] == 0
    assert batch.steps("a") == WHOLE * 2 and batch.content()["preset"] == "balanced"


def test_all_starts_again_without_the_captures_named_again(batch):
    for name in ("a", "b"):
        batch.add(name)
    batch.run()
    assert batch.run(captures=[], overwrite=True)[0] == 0
    assert batch.steps("a") == batch.steps("b") == WHOLE * 2


def test_one_object_that_starts_again_leaves_the_others_alone(batch):
    one, other = batch.add("1/vase"), batch.add("2/vase")
    batch.run(captures=[one, other])
    kept = batch.objects()["vase"]
    (other / "plays").write_text("refuse")
    assert batch.run(captures=[other], overwrite=True)[0] == 9
    found = batch.objects()
    assert list(found) == ["vase", "vase-2"] and found["vase"] == kept
    assert found["vase-2"]["capture"] == str(other) and found["vase-2"]["state"] == "failed"
    assert found["vase-2"]["attempts"] == 1 and found["vase-2"]["warnings"] == [], "nothing is left of the first start"
    assert batch.steps("vase") == WHOLE and (batch.out / "vase/report.json").is_file()
    assert not (batch.out / "vase-2/report.json").exists()
    page = (batch.out / "index.html").read_text(encoding="utf-8")
    assert 'href="vase/' in page and "the photos are no good" in page


def test_other_settings_need_all_objects_to_start_again(batch):
    one, other = batch.add("a"), batch.add("b")
    batch.run()
    before = (batch.out / "batch.json").read_bytes()
    code, events = batch.run(captures=[one], seed=3, overwrite=True)
    assert code == 2 and events[-1]["name"] == "usage.other_batch" and "--seed 0" in events[-1]["message"]
    assert (batch.out / "batch.json").read_bytes() == before and (batch.out / "a/report.json").is_file()
    assert batch.run(captures=[other, one], seed=3, overwrite=True)[0] == 0
    assert batch.content()["arguments"]["seed"] == 3 and list(batch.objects()) == ["a", "b"]
    assert batch.run(captures=[], seed=4, overwrite=True)[0] == 0
    assert batch.steps("a") == batch.steps("b") == WHOLE * 3


def test_every_job_of_a_batch_gets_its_number_of_faces(batch):
    batch.add("a")
    assert batch.run(faces=5000)[0] == 0
    given = json.loads((batch.out / "a" / "arguments.json").read_text())
    assert given[given.index("--faces") + 1] == "5000"
    assert batch.run(faces=5000)[0] == 0 and batch.run()[1][-1]["name"] == "usage.other_batch"
    content = batch.content()
    del content["arguments"]["faces"]  # as in a batch of an older version, which had no such option
    (batch.out / "batch.json").write_text(json.dumps(content))
    assert batch.run()[0] == 0
    assert batch.run(faces=5000)[1][-1]["name"] == "usage.other_batch"


def test_a_second_batch_in_one_folder_is_refused(batch):
    slow = batch.add("a", "slow")
    first = threading.Thread(target=batch.run)
    first.start()
    try:
        wait_until((batch.out / "a/waiting").exists)
        code, events = batch.run()
    finally:  # else a failure would wait for the first batch for ever
        (slow / "go").touch()
        first.join()
    assert code == 2 and events[-1]["name"] == "usage.folder_in_use"
    assert events[-1]["message"] == f"another batch is at work in {batch.out}"
    assert batch.objects()["a"]["state"] == "done"


@pytest.mark.parametrize("text", ["{", "[]", '{"format": 1}', '{"format": 9, "objects": []}'])
def test_a_damaged_state_is_refused_and_kept(batch, text):
    batch.add("a")
    batch.out.mkdir()
    (batch.out / "batch.json").write_text(text)
    (batch.out / "batch.lock").touch()  # of the batch whose state it was
    code, events = batch.run()
    assert code == 2 and "--overwrite" in events[-1]["hint"] and (batch.out / "batch.json").read_text() == text
    assert batch.run(overwrite=True)[0] == 0


@pytest.mark.parametrize("plays", [pytest.param("slow", marks=pytest.mark.slow), "deaf"])
def test_a_killed_batch_leaves_no_orphans_and_goes_on(batch, monkeypatch, plays):
    monkeypatch.setattr("blender_nep.batch.workers.machine._LONGEST_WAIT_S", 0.5)
    for name in ("a", "b"):
        batch.add(name, plays)
    script = (
        "from pathlib import Path; from blender_nep.batch import runner\n"
        "from blender_nep.batch.settings import BatchSettings\n"
        "from blender_nep.job.reporting.events import Events; from blender_nep.stop_request import StopRequest\n"
        f"wanted = {{'preset': 'preview', 'workers': 1, 'threads': 1, 'memory_mb': 2e4, 'engine': {batch.engine!r}}}\n"
        f"settings = BatchSettings((Path({str(batch.captures)!r}),), Path({str(batch.out)!r}), **wanted)\n"
        "runner.run(settings, Events(), StopRequest())"
    )
    parent = subprocess.Popen([sys.executable, "-c", script], env=os.environ | {"PYTHONPATH": str(ROOT)})
    try:
        wait_until((batch.out / "a/waiting").exists)
        parent.kill()
        parent.wait()
        if plays == "slow":
            wait_until(lambda: not jobs_in(batch.out))
        for name in ("a", "b"):
            (batch.captures / name / "plays").unlink()
        assert batch.run()[0] == 0
        assert batch.steps("a") == batch.steps("b") == WHOLE
        assert plays == "slow" or "1 job of a batch that was killed" in batch.said
    finally:
        for process in (parent, *jobs_in(batch.out)):
            with contextlib.suppress(psutil.Error, ProcessLookupError):
                os.kill(process.pid, signal.SIGKILL)


@pytest.mark.parametrize("held", [False, True])
def test_jobs_of_a_killed_batch_that_are_not_named_are_stopped(batch, held):
    """Unless a process is at work there, such as a run that somebody has started by hand."""
    one, other = batch.add("a"), batch.add("b")
    batch.run()
    content = batch.content()
    left = {"state": "running", "stage": "surface", "fraction": 0.6, "eta_s": 30.0}
    content["objects"][1] |= left
    (batch.out / "batch.json").write_text(json.dumps(content))
    with job_folder.held(batch.out / "b") if held else contextlib.nullcontext():
        assert batch.run(captures=[one])[0] == 0
    expected = left if held else left | {"state": "stopped", "stage": None, "eta_s": None}
    assert {key: batch.objects()["b"][key] for key in left} == expected and batch.objects()["a"]["state"] == "done"
    (batch.out / "b/report.json").unlink()
    assert batch.run(captures=[other])[0] == 0 and batch.objects()["b"]["state"] == "done"


def test_an_unforeseen_error_in_one_capture_stops_no_other(batch, monkeypatch):
    size_of = runner.size_of

    def size_or_crash(found):
        if found.path.name == "odd":
            raise ZeroDivisionError("a bug")
        return size_of(found)

    monkeypatch.setattr(runner, "size_of", size_or_crash)
    for name in ("good", "odd"):
        batch.add(name)
    assert batch.run()[0] == 9
    found = batch.objects()
    assert found["good"]["state"] == "done" and found["odd"]["state"] == "failed"
    assert found["odd"]["error"]["code"] == 1 and "a bug" in found["odd"]["error"]["message"]
    assert "ZeroDivisionError" in (batch.out / "log.txt").read_text(), "for who mends it"


def test_an_unforeseen_error_in_the_gallery_ends_no_batch(batch, monkeypatch):
    def crash(_folder):
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr("blender_nep.batch.pages.write_gallery", crash)
    batch.add("a")
    code, events = batch.run()
    warned = [event["code"] for event in events if event["event"] == "warning"]
    assert code == 0 and warned.count("batch.no_gallery") == 1
    assert (batch.out / "log.txt").read_text().count("ZeroDivisionError: a bug") == 1


@pytest.fixture
def deaf_job(batch):
    """Starts a job that never ends, in the batch's folder; as a batch would, or as somebody else."""
    started = []

    def start(name: str, *, by_batch: bool) -> subprocess.Popen:
        out = batch.out / name
        capture, options = batch.add(name, "deaf"), ("--out", str(out), "--resume", "--watch-stdin")
        command = [*batch.engine, "reconstruct", str(capture), *options]
        env = os.environ | ({OUT_OF_JOB: str(out)} if by_batch else {})
        started.append(subprocess.Popen(command, stdin=subprocess.PIPE, env=env))
        wait_until((out / "waiting").exists)
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.communicate()


def test_a_job_that_somebody_else_started_goes_on(batch, deaf_job, monkeypatch):
    monkeypatch.setattr("blender_nep.batch.workers.machine._LONGEST_WAIT_S", 0.2)
    process = deaf_job("theirs", by_batch=False)
    other = batch.add("ours")
    assert batch.run(captures=[other])[0] == 0
    assert process.poll() is None


def test_a_batch_that_waits_for_old_jobs_can_be_stopped(batch, deaf_job):
    process = deaf_job("left", by_batch=True)
    stop = StopRequest()
    threading.Timer(0.5, stop.request, ["test"]).start()
    assert batch.run(stop)[0] == 7
    assert process.poll() is None, "the batch did not wait for two minutes, after which it kills"


def test_photos_alone_get_cameras_first(batch, make_capture):
    make_capture(name="captures/shots", size=8, suffix=".png").folder.joinpath("transforms.json").unlink()
    assert batch.run()[0] == 0
    one = batch.objects()["shots"]
    assert one["photos_alone"] and (batch.out / "shots/capture/transforms.json").is_file()
    assert f'"{batch.out}/shots/capture"' in (batch.out / "shots/arguments.json").read_text()


def test_a_program_that_cannot_be_started_is_told(batch):
    batch.add("a")
    code, events = batch.run(engine=("/no/such/python",))
    assert code == 1 and "FileNotFoundError" in events[-1]["message"] and Scheduler.poll_s == 0.01
