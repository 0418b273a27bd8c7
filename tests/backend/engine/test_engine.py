"""Jobs that are followed by their files: they outlive their starter, are found again, are stopped, and report errors."""

import fcntl
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from backend.engine import engine as engine_module
from backend.engine.command import NoEngineError, reconstruct_arguments
from backend.engine.engine import Engine, FoundProcess
from backend.engine.results.job_files import has_checkpoint, is_asset, is_running, read_job
from support import ball_engine
from support.own_process import LIMIT_S
from support.paths import ROOT
from support.played_python import bare_python
from support.waiting import wait_until

SLOW = {"BALL_STEPS": "4000", "BALL_DELAY": "0.02"}


@pytest.fixture
def ball(make_capture, tmp_path, monkeypatch):
    """ball(**options) starts an engine; ball.out is the output folder."""

    def start(slow=False, keep_going=False, **options):
        for name, value in SLOW.items():
            if slow:
                monkeypatch.setenv(name, value)
            else:
                monkeypatch.delenv(name, raising=False)
        arguments = reconstruct_arguments(start.capture, start.out, preset="preview", keep_going=keep_going, **options)
        engine = Engine.start(start.python, arguments, keep_going=keep_going)
        started.append(engine)
        return engine

    started = []
    start.python, start.capture, start.out = ball_engine.make(tmp_path), make_capture(masks=True).folder, tmp_path / "asset"
    yield start
    for engine in started:
        engine.close()
        if read_job(start.out) and is_running(start.out):
            os.kill(read_job(start.out)["pid"], signal.SIGKILL)


def follow(engine) -> list[dict]:
    """All events up to the end."""
    events = []
    wait_until(lambda: events.extend((polled := engine.poll())[0]) or polled[1])
    return events


def at_work(out: Path):
    """Wait until learning has written a checkpoint, and return the job's description."""
    wait_until((out / "checkpoints" / "fields_learning.pt").exists)
    return read_job(out)


def test_a_followed_job_has_an_asset_that_no_other_job_replaces(ball):
    engine = ball()
    told = follow(engine)
    assert engine.outcome() is None and is_asset(ball.out) and not is_running(ball.out)
    assert told[0]["event"] == "job" and told[-1]["event"] == "done"
    assert {"progress", "preview"} <= {event["event"] for event in told}
    job = read_job(ball.out)
    assert job["preset"] == "preview" and job["capture"] == str(ball.capture) and "--job-files" in job["arguments"]
    found = Engine.attach(ball.out)
    events, ended = found.poll()
    assert ended and found.outcome() is None and events == told[1:], "its events can be read again"
    assert Engine.attach(ball.out / "elsewhere") is None
    before = {path: path.stat().st_mtime_ns for path in ball.out.rglob("*")}
    another = ball()
    follow(another)
    assert another.outcome().code == 2 and "already holds an asset" in another.outcome().message
    assert {path: path.stat().st_mtime_ns for path in ball.out.rglob("*")} == before


STARTER = """
import os, sys
sys.path.insert(0, {root!r})
from backend.engine.engine import Engine
engine = Engine.start({python!r}, {arguments!r}, keep_going={keep_going})
while not os.path.exists({sign!r}):
    assert not engine.poll()[1], open(engine.log).read()
os.kill(os.getpid(), 9)
"""


@pytest.mark.slow
@pytest.mark.parametrize("keep_going", [True, False])
def test_a_job_outlives_its_starter_only_with_keep_going(ball, keep_going):
    """With keep_going the job goes on, is found, stopped by its file and resumed. Otherwise it writes its checkpoint."""
    arguments = reconstruct_arguments(ball.capture, ball.out, preset="preview", keep_going=keep_going)
    sign = ball.out / "checkpoints" / "fields_learning.pt"
    script = STARTER.format(root=str(ROOT), python=ball.python, arguments=arguments, keep_going=keep_going, sign=str(sign))
    starter = subprocess.run([sys.executable, "-c", script], env=os.environ | SLOW, timeout=LIMIT_S, stderr=subprocess.PIPE)
    assert starter.returncode == -9, starter.stderr
    found = Engine.attach(ball.out)
    if keep_going:
        before = len(found.poll()[0])
        wait_until(lambda: found.poll()[0])
        assert before and is_running(ball.out), "it goes on"
        found.request_stop()
    follow(found)
    assert found.outcome().code == 7 and not is_running(ball.out) and has_checkpoint(ball.out)
    assert not is_asset(ball.out)
    engine = ball(resume=True)
    told = follow(engine)
    assert engine.outcome() is None and is_asset(ball.out) and not has_checkpoint(ball.out)
    assert told[0]["event"] == "job" and not [e for e in told if e["event"] == "error"], "nothing is left of the run before"
    assert not (ball.out / "job" / "stop").exists()


def test_a_killed_engine_is_reported_to_starter_and_follower(ball, monkeypatch):
    engine = ball(slow=True, keep_going=True)
    wait_until(lambda: engine.poll() and (ball.out / "checkpoints" / "fields_learning.pt").exists())
    os.kill(read_job(ball.out)["pid"], signal.SIGKILL)
    follow(engine)
    assert engine.outcome().code == 128 + 9 and "was killed" in engine.outcome().message
    with monkeypatch.context() as patch:
        patch.setattr(engine_module.shutil, "disk_usage", lambda _folder: SimpleNamespace(free=0))
        error = engine.outcome()
    assert error.code == 5 and error.name == "output.disk_full" and str(ball.out) in error.words()[0]
    found = Engine.attach(ball.out)
    follow(found)
    assert "was killed" in found.outcome().message and "Resume" in found.outcome().hint
    again = ball(resume=True)
    follow(again)
    assert again.outcome() is None


@pytest.mark.parametrize(("host", "ended"), [("another computer", False), (socket.gethostname(), True), ("", True)])
def test_a_process_of_another_computer_is_not_ended_here(tmp_path, host, ended):
    """Locks are known to all computers that share a network drive, numbers of processes are not."""
    (tmp_path / "job").mkdir()
    lock = os.open(tmp_path / "job" / "lock", os.O_RDWR | os.O_CREAT)
    fcntl.flock(lock, fcntl.LOCK_EX)
    process = subprocess.Popen(["sleep", "60"])
    try:
        FoundProcess(tmp_path, process.pid, host).send(kill=False)
        if ended:
            assert process.wait(LIMIT_S) == -signal.SIGTERM
        else:
            time.sleep(0.2)
            assert process.poll() is None
    finally:
        process.kill()
        process.wait()
        os.close(lock)


@pytest.mark.slow
def test_two_jobs_cannot_work_in_one_folder(ball):
    first = ball(slow=True)
    at_work(ball.out)
    before = read_job(ball.out)
    second = ball(resume=True)
    follow(second)
    assert second.outcome().code == 2 and "another run or correction is at work" in second.outcome().message
    assert read_job(ball.out) == before and not first.poll()[1]
    first.request_stop()
    follow(first)
    assert first.outcome().code == 7


def test_a_capture_that_is_gone_is_reported(ball):
    shutil.rmtree(ball.capture)
    engine = ball()
    follow(engine)
    assert engine.outcome().code == 3 and str(ball.capture) in engine.outcome().message
    assert not is_asset(ball.out) and not has_checkpoint(ball.out)


def test_an_output_folder_that_vanishes_is_reported(ball):
    engine = ball(slow=True)
    wait_until(lambda: engine.poll() and (ball.out / "checkpoints" / "fields_learning.pt").exists())
    while ball.out.exists():
        shutil.rmtree(ball.out, ignore_errors=True)
    follow(engine)
    assert engine.outcome().code == 5 and str(ball.out) in engine.outcome().message


def test_an_engine_that_ignores_requests_to_stop_is_killed(engine_python, tmp_path, monkeypatch):
    monkeypatch.setenv("SCRIPTED_ENGINE", "deaf")
    monkeypatch.setattr(engine_module, "STOP_GRACE_S", 0.1)
    monkeypatch.setattr(engine_module, "TERMINATE_GRACE_S", 0.1)
    engine = Engine.start(engine_python, ["reconstruct", "x", "--out", str(tmp_path / "out")])
    wait_until((tmp_path / "out" / "waiting").exists)
    engine.request_stop()
    follow(engine)
    assert engine.outcome().code == 128 + 9
    engine.close()


def test_a_python_without_the_engine_is_reported(tmp_path):
    bare = bare_python(tmp_path)
    engine = Engine.start(bare, ["reconstruct", "x", "--out", str(tmp_path / "out")])
    follow(engine)
    failed = engine.outcome()
    assert isinstance(failed, NoEngineError) and f"{bare} lacks blender_nep" in failed.message and "Install" in failed.hint
    with pytest.raises(NoEngineError, match="cannot be started"):
        Engine.start(str(tmp_path / "no-python"), [])
