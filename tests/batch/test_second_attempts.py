"""What is tried again, in the same start and in the next one, and what was corrected between both."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

WHOLE = ["0", "1", "2", "3"]


@pytest.fixture
def other_run(batch):
    """Makes a capture whose job refuses the checkpoints that are in its folder, and returns that folder."""

    def make(error: str = "usage.other_run", plays: str = "") -> Path:
        batch.add("a", plays)
        (batch.out / "a/checkpoints").mkdir(parents=True)
        (batch.out / "a/checkpoints/refused").write_text(error)
        return batch.out / "a"

    return make


@pytest.mark.parametrize("error", ["usage.other_run", "usage.other_version", "usage.unknown_run"])
def test_checkpoints_of_another_run_are_removed(batch, other_run, error):
    other_run(error)
    code, events = batch.run()
    told = [event for event in events if event["event"] == "warning" and event["code"] == "batch.tried_again"]
    assert code == 0 and batch.steps("a") == WHOLE and batch.objects()["a"]["attempts"] == 2
    assert [event["values"]["reason"] for event in told] == ["cannot resume"]


def test_a_job_that_begins_anew_may_still_crash_once(batch, other_run):
    other_run(plays="crash 2")
    assert batch.run()[0] == 0 and batch.objects()["a"]["attempts"] == 3


def test_checkpoints_that_cannot_be_removed_are_tried_only_once(batch, other_run, monkeypatch):
    other_run()
    monkeypatch.setattr("blender_nep.batch.scheduler.shutil.rmtree", lambda *_, **__: None)
    assert batch.run()[0] == 9
    one = batch.objects()["a"]
    assert one["attempts"] == 2 and one["error"]["name"] == "usage.other_run"


def test_a_complete_asset_of_another_run_keeps_its_checkpoints(batch, other_run):
    folder = other_run()
    (folder / "report.json").write_text("{}")
    assert batch.run()[0] == 9
    assert batch.objects()["a"]["attempts"] == 1 and (folder / "checkpoints/refused").exists()


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
    mark = batch.out / "shots/capture/mark"
    mark.touch()
    assert batch.run()[0] == 9 and mark.exists(), "the photos are the same"
    change(shots / "images")
    assert batch.run()[0] == 9 and not mark.exists()
    assert batch.objects()["shots"]["size"]["photos"] == photos
