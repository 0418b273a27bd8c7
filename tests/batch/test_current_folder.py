"""The job of a batch runs nothing from the current folder, which may hold files of strangers."""

from __future__ import annotations

import os
import sys
import threading
from pathlib import Path

from blender_nep.batch.settings import ENGINE
from blender_nep.batch.workers.job_process import JobProcess
from blender_nep.batch.workers.jobs import Job
from blender_nep.stop_request import StopRequest
from support.traps import set_traps
from support.waiting import wait_until

WHERE = "import os, pathlib, sys; pathlib.Path(sys.argv[4], 'where').write_text(os.getcwd())"


def test_a_job_runs_no_module_of_the_current_folder(batch, tmp_path, monkeypatch):
    """The batch is stopped as soon as its job has told its first stage."""
    batch.add("a")
    sprung = set_traps(tmp_path / "stranger", "blender_nep")
    monkeypatch.chdir(sprung.parent)
    stop, ended = StopRequest(), threading.Event()

    def stop_it():
        wait_until(lambda: ended.is_set() or ((batch.out / "batch.json").exists() and batch.objects()["a"]["stage"]))
        stop.request("test")

    stopper = threading.Thread(target=stop_it)
    stopper.start()
    code, _ = batch.run(stop, engine=ENGINE)
    ended.set()
    stopper.join()
    assert not sprung.exists()
    assert code == 7 and batch.objects()["a"]["state"] == "stopped", batch.said


def test_the_current_folder_of_a_job_is_neutral(tmp_path, monkeypatch):
    (tmp_path / "out").mkdir()
    monkeypatch.chdir(tmp_path / "out")
    job = Job("a", tmp_path, tmp_path / "out", False, (), (sys.executable, "-c", WHERE), threads=1, memory_mb=100)
    process = JobProcess(job, "local")
    wait_until(lambda: not process.poll() and not process.running)
    assert Path("where").read_text() == os.path.abspath(os.sep)


def test_a_relative_capture_is_found_from_the_neutral_folder(batch, tmp_path, monkeypatch):
    """batch.json of another hand may name a capture by a relative path."""
    batch.add("a")
    assert batch.run()[0] == 0
    content = (batch.out / "batch.json").read_text()
    (batch.out / "batch.json").write_text(content.replace(str(batch.captures), "captures"))
    (batch.out / "a/report.json").unlink()
    monkeypatch.chdir(tmp_path)
    assert batch.run(captures=[])[0] == 0 and batch.objects()["a"]["capture"] == "captures/a"
