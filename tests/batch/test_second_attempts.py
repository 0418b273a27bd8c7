"""What is tried again, in the same start and in the next one, and what was corrected between both."""

from __future__ import annotations

import errno
import itertools
import json
import shutil
import subprocess
import threading
from pathlib import Path
from unittest.mock import Mock

import pytest

from blender_nep.batch.workers.job_process import JobProcess
from blender_nep.batch.workers.jobs import Job
from blender_nep.batch.workers.machine import jobs_in
from blender_nep.errors import OutputError
from blender_nep.job.folders.job_folder import JobFolder

WHOLE = ["0", "1", "2", "3"]


@pytest.fixture
def other_run(batch):
    """Makes a capture whose job refuses the checkpoints that are in its folder, and returns that folder."""

    def make(error: str = "usage.other_run", plays: str = "") -> Path:
        batch.add("a", plays)
        (batch.out / "a/checkpoints").mkdir(parents=True)
        run = {"format": 1, "capture": "", "preset": "", "seed": 0, "refused": error}
        (batch.out / "a/checkpoints/run.json").write_text(json.dumps(run))
        (batch.out / "a/checkpoints/surface.done.pt").touch()
        return batch.out / "a"

    return make


@pytest.mark.parametrize("error", ["usage.other_run", "usage.other_version"])
def test_checkpoints_of_another_run_are_removed(batch, other_run, error):
    other_run(error)
    code, events = batch.run()
    told = [event for event in events if event["event"] == "warning" and event["code"] == "batch.tried_again"]
    assert code == 0 and batch.steps("a") == WHOLE and batch.objects()["a"]["attempts"] == 2
    assert [event["values"]["reason"] for event in told] == ["cannot resume"]


def test_a_job_that_begins_anew_may_still_crash_once(batch, other_run):
    other_run(plays="crash 2")
    assert batch.run()[0] == 0 and batch.objects()["a"]["attempts"] == 3


def test_checkpoints_that_cannot_be_removed_fail_the_object(batch, other_run, monkeypatch):
    other_run()
    refused = OutputError("the disk cannot be written")
    monkeypatch.setattr("blender_nep.batch.workers.scheduler.discard_run", Mock(side_effect=refused))
    assert batch.run()[0] == 9
    one = batch.objects()["a"]
    assert one["attempts"] == 1 and one["error"]["name"] == "usage.other_run"


def test_a_complete_asset_of_another_run_keeps_its_checkpoints(batch, other_run):
    folder = other_run()
    (folder / "report.json").write_text("{}")
    assert batch.run()[0] == 9
    assert batch.objects()["a"]["attempts"] == 1 and (folder / "checkpoints/surface.done.pt").exists()


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_run_that_somebody_else_started_keeps_its_checkpoints(batch, other_run, overwrite):
    folder = other_run()
    run = JobFolder(folder, followed=True)
    try:
        assert batch.run(overwrite=overwrite)[0] == 9
    finally:
        run.close()
    assert (folder / "checkpoints/surface.done.pt").exists()


def test_the_capture_of_a_failed_object_is_measured_again(batch):
    folder = batch.add("a", "refuse")
    batch.run()
    assert batch.objects()["a"]["size"]["photos"] == 6
    shutil.rmtree(folder)
    batch.add("a", views=8)
    assert batch.run()[0] == 0 and batch.objects()["a"]["size"]["photos"] == 8


def add(images: Path) -> None:
    shutil.copy(images / "000.png", images / "900.png")


def remove(images: Path) -> None:
    (images / "005.png").unlink()


def replace(images: Path) -> None:
    (images / "005.png").write_bytes((images / "000.png").read_bytes())


@pytest.mark.parametrize(("change", "photos"), [(add, 7), (remove, 5), (replace, 6)])
def test_cameras_of_other_photos_are_found_again(batch, change, photos):
    shots = batch.add("shots", "refuse")
    (shots / "transforms.json").unlink()
    assert batch.run()[0] == 9
    found = batch.out / "shots/capture/transforms.json"
    found.write_text(json.dumps(json.loads(found.read_text()) | {"marked": True}))
    assert batch.run()[0] == 9 and "marked" in found.read_text(), "the photos are the same"
    change(shots / "images")
    assert batch.run()[0] == 9 and "marked" not in found.read_text()
    assert batch.objects()["shots"]["size"]["photos"] == photos


@pytest.fixture
def no_process(monkeypatch):
    """Lets the system have no process left at the starts with these numbers, counted from 0."""

    def at(*numbers: int) -> None:
        counted, popen = itertools.count(), subprocess.Popen

        def start(*arguments, **options):
            if next(counted) in numbers:
                raise BlockingIOError(errno.EAGAIN, "Resource temporarily unavailable")
            return popen(*arguments, **options)

        monkeypatch.setattr(subprocess, "Popen", start)

    return at


def test_a_job_that_cannot_be_started_now_is_tried_again(batch, no_process):
    no_process(1)
    for name in ("a", "b"):
        batch.add(name)
    assert batch.run()[0] == 0
    assert [one["attempts"] for one in batch.objects().values()] == [1, 2]


def test_a_job_that_can_never_be_started_stops_no_other(batch, no_process):
    no_process(1, 2)
    for name in ("a", "b"):
        batch.add(name)
    assert batch.run()[0] == 9
    found = batch.objects()
    assert found["a"]["state"] == "done" and found["b"]["state"] == "failed" and found["b"]["attempts"] == 2
    assert "Resource temporarily unavailable" in found["b"]["error"]["message"] and found["b"]["error"]["hint"]


def test_a_job_whose_cameras_are_found_may_start_later(batch, no_process):
    no_process(1)
    (batch.add("shots") / "transforms.json").unlink()
    assert batch.run()[0] == 0 and batch.objects()["shots"]["attempts"] == 2


def test_a_job_without_a_listening_thread_is_tried_again(batch, monkeypatch):
    """The process is there already. It must not go on beside the second attempt."""
    counted, start, left = itertools.count(), threading.Thread.start, []

    def start_or_fail(thread):
        if next(counted) == 1:
            raise RuntimeError("can't start new thread")
        left.append(len(jobs_in(batch.out)))
        start(thread)

    batch.add("a")
    monkeypatch.setattr(threading.Thread, "start", start_or_fail)
    assert batch.run()[0] == 0 and batch.objects()["a"]["attempts"] == 2 and batch.steps("a") == WHOLE
    assert max(left) == 1


def test_a_job_that_was_not_started_can_be_stopped(batch, no_process):
    no_process(0)
    job = Job("a", batch.captures, batch.out / "a", False, (), batch.engine, 1, 100.0)
    process = JobProcess(job, "local")
    process.stop()
    process.kill()
    assert [heard.kind for heard in process.poll()] == ["started", "ended"] and not process.running
