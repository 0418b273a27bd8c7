"""States on the disk: they come back as they were, run no code, and outlive a kill in the middle of a save."""

from __future__ import annotations

import errno
import os

import numpy as np
import pytest
import torch

from blender_nep import files
from blender_nep.checkpoints import Checkpoint, load_state, save_state
from blender_nep.errors import OutputError, Stopped
from blender_nep.materials.training_progress import TrainingProgress
from blender_nep.stop_request import StopRequest


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
    assert len(warnings) == 1 and warnings[0].code == "job.checkpoint_damaged"
    assert warnings[0].values["file"] == "stage.pt" and "damaged" in warnings[0].values["reason"]
    first.previous.write_bytes(b"")
    assert Checkpoint(tmp_path, "stage", StopRequest(), warnings.append).load() is None


def test_whatever_unpickling_raises_the_file_counts_as_damaged(tmp_path, monkeypatch):
    first = Checkpoint(tmp_path, "stage", StopRequest(), [].append)
    first.save({"step": 1})
    first.save({"step": 2})
    whole = torch.load

    def load(path, **options):
        if path == first.path:
            raise IndexError("pop from empty list")
        return whole(path, **options)

    monkeypatch.setattr(torch, "load", load)
    with pytest.raises(ValueError, match=r"stage\.pt is damaged \(IndexError\)"):
        load_state(first.path)
    resumed = Checkpoint(tmp_path, "stage", StopRequest(), [].append)
    assert resumed.load() == {"step": 1} and not first.path.exists(), "it must not take the place of the good one"
    resumed.save({"step": 3})
    monkeypatch.undo()
    assert load_state(resumed.path)["state"] == {"step": 3} and load_state(resumed.previous)["state"] == {"step": 1}


def test_a_state_that_has_not_changed_is_not_written_again(tmp_path):
    now, stop, seen = [0.0], StopRequest(), []
    checkpoint = Checkpoint(tmp_path, "stage", stop, print, clock=lambda: now[0])
    progress = TrainingProgress(lambda *told: seen.append(told), checkpoint, {}, 0.0)
    now[0] = 16.0
    progress.step(10)
    progress.state = {"light": 1}
    now[0] = 40.0
    progress.step(70)
    assert seen[-1] == (70, 100, None), "nothing has been learned, so there is no loss"
    written = checkpoint.path.stat().st_mtime_ns
    now[0] = 80.0
    progress.step(75)
    stop.request("SIGTERM")
    progress.step(80)
    assert checkpoint.path.stat().st_mtime_ns == written and checkpoint.load() == {"light": 1}
    with pytest.raises(Stopped):
        checkpoint.raise_if_stopped(saves=True)


def test_a_checkpoint_is_due_every_15_seconds_and_counts_time(tmp_path):
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


@pytest.mark.parametrize("refusals", [2, 100])
def test_a_file_that_another_program_reads_is_replaced_later(tmp_path, monkeypatch, refusals):
    """So Windows refuses to replace it for an instant."""
    left, replace = [refusals], os.replace

    def refuse(source, target):
        left[0] -= 1
        if left[0] >= 0:
            raise PermissionError(errno.EACCES, "Access is denied")
        replace(source, target)

    monkeypatch.setattr(files, "_WINDOWS", True)
    monkeypatch.setattr(files, "_PAUSE_S", 0.0)
    monkeypatch.setattr(os, "replace", refuse)
    (tmp_path / "a.json").write_text("old")
    if refusals > 20:
        with pytest.raises(OutputError, match="may not be written"):
            files.write_text(tmp_path / "a.json", "new")
    else:
        files.write_text(tmp_path / "a.json", "new")
    assert (tmp_path / "a.json").read_text() == ("old" if refusals > 20 else "new")
    assert [path.name for path in tmp_path.iterdir()] == ["a.json"]
