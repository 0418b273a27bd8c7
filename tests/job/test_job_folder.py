"""Files of the job folder: they survive a full disk."""

from __future__ import annotations

import errno
import fcntl
import json
import os
import threading

import pytest

from backend.engine.results.job_files import is_running
from backend.engine.words import error_words
from blender_nep.job.folders.job_folder import JobFolder, Journal, held, is_held, wait_until_free
from support.ball_stages import BallStages


def test_a_journal_outlives_a_full_disk(tmp_path, monkeypatch):
    journal, room = Journal(tmp_path / "journal"), [5]
    write = os.write

    def narrow(descriptor, data):
        if not room[0]:
            raise OSError(errno.ENOSPC, "No space left on device")
        taken = write(descriptor, data[: room[0]])
        room[0] -= taken
        return taken

    monkeypatch.setattr(os, "write", narrow)
    journal.write("first line\n")
    journal.flush()
    room[0] = 100
    journal.write("second line\n")
    journal.flush()
    assert (tmp_path / "journal").read_text() == "first line\nsecond line\n"


@pytest.mark.parametrize("options", [{"overwrite": True, "seed": 1}, {"resume": True}])
def test_a_folder_at_which_a_run_works_is_refused_to_another(start, options):
    def begin_another(stage, step):
        if (stage, step) == ("material_learning", 2):
            refused.append(start(BallStages(), **options))
            assert is_held(start.out)

    refused: list = []
    code, events = start(BallStages(on_step=begin_another))
    assert code == 0 and events[-1]["event"] == "done"
    ((code, events),) = refused
    assert code == 2 and events[-1]["name"] == "usage.folder_in_use"
    assert json.loads((start.out / "report.json").read_text())["seed"] == 0
    assert not is_held(start.out) and start(BallStages(), overwrite=True)[0] == 0, "the folder is free again"


def test_a_folder_in_correction_is_refused_to_a_run(start):
    """The message is true of a run and of a correction: the lock does not tell which of them holds it."""
    assert start(BallStages())[0] == 0
    with held(start.out):
        code, events = start(BallStages(), overwrite=True)
    assert code == 2 and events[-1]["name"] == "usage.folder_in_use"
    assert events[-1]["message"] == f"another run or correction is at work in {start.out}"
    panel, _ = error_words(*(events[-1][key] for key in ("name", "values", "message", "hint")))
    assert panel == f"The engine is at work in {start.out} already"


@pytest.mark.parametrize(("followed", "expected"), [(False, 0), (True, 5)])
def test_where_a_network_drive_knows_no_locks(start, monkeypatch, followed, expected):
    def refuse(descriptor, how):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(fcntl, "flock", refuse)
    monkeypatch.setattr(JobFolder, "take_stderr", lambda self: None)
    code, events = start(BallStages(), job_files=followed)
    assert code == expected and (code == 0 or "No locks available" in events[-1]["message"])
    assert not is_running(start.out) and not is_held(start.out), "else the sidebar would wait for it for ever"


def test_a_job_waits_for_the_end_of_another_one_in_its_folder(tmp_path):
    run = JobFolder(tmp_path, followed=False)
    wait_until_free(tmp_path, 0)
    assert is_held(tmp_path), "a wait that is too short ends before the other run"
    threading.Timer(0.3, run.close).start()
    wait_until_free(tmp_path, 60)
    assert not is_held(tmp_path)
