"""The engine process that finds the cameras of photos: its progress, its end, and how it is stopped."""

import errno
import json
import os
import subprocess
import sys

import pytest

from backend.engine import engine as engine_module
from backend.engine import words
from backend.engine.command import NoEngineError, cameras_arguments
from backend.engine.commands import camera_process
from backend.engine.commands.camera_process import CameraError, CameraProcess, check_writable
from backend.engine.exit_codes import OUTPUT_FAILED, STOPPED
from blender_nep import command_line
from support import camera_engine
from support.own_process import LIMIT_S
from support.paths import ROOT
from support.played_python import bare_python
from support.waiting import wait_until


@pytest.fixture
def photos(tmp_path):
    return camera_engine.write_photos(tmp_path / "photos")


@pytest.fixture
def engine(tmp_path):
    """engine(mode): the path of an engine that behaves so."""

    def make(mode: str) -> str:
        (tmp_path / "mode").write_text(mode)
        return camera_engine.make(tmp_path)

    return make


def searched(python: str, photos, **options) -> CameraProcess:
    """The process after its end."""
    process = CameraProcess(python, photos, **options)
    wait_until(process.poll)
    return process


def has_begun(process: CameraProcess) -> bool:
    return not process.poll() and process.progress.fraction > 0


def test_the_library_understands_the_arguments():
    found = command_line.parser().parse_args(cameras_arguments("/photos", threads=2, overwrite=True))
    assert (found.command, str(found.photos), found.out, found.threads) == ("cameras", "/photos", None, 2)
    assert found.overwrite and found.watch_stdin and found.features == "everywhere"
    assert cameras_arguments("/photos") == ["cameras", "/photos", "--watch-stdin"]
    found = command_line.parser().parse_args(cameras_arguments("photos", overwrite=True, improve=True, features="object"))
    assert (found.improve, found.overwrite, found.features) == (True, True, "object")
    found = command_line.parser().parse_args(cameras_arguments("film.mp4", out="capture", frames=40))
    assert found.frames == 40 and found.out.is_absolute() and found.out.name == "capture"


def test_what_was_found_is_told(engine, photos, tmp_path):
    process = searched(engine("well"), photos, threads=3)
    assert process.failed is None and len(json.loads((photos / "transforms.json").read_text())["frames"]) == 5
    assert json.loads((tmp_path / "arguments.json").read_text()) == ["--watch-stdin", "--threads", "3"]
    lines = process.progress.lines()
    assert lines == ["Finding the cameras", "Looked for details in 3 of 6 photos", "about 1 min 20 s left"]
    assert [said.words() for said in process.found] == [
        "5 of 6 photos were placed. The details that they share agree within 0.31 pixels."
    ]
    assert [said.words()[:22] for said in process.warnings] == ["1 photo was not placed"]


def test_cameras_that_are_there_are_replaced_only_on_demand(engine, photos):
    python = engine("sure")
    (photos / "transforms.json").write_text("mine")
    message, hint = searched(python, photos).failed.words()
    assert message == f"{photos} has cameras already" and "Find Cameras Again" in hint
    assert (photos / "transforms.json").read_text() == "mine"
    process = searched(python, photos, overwrite=True)
    assert process.failed is None and process.found[-1].words() == "The cameras look right."


@pytest.mark.parametrize(
    ("mode", "message", "hint"),
    [
        ("fail", "No photo could be placed", "Put the object on a sheet with a print"),
        (
            "locked",
            "{}/transforms.json may not be written (Permission denied)",
            "Change its permissions, or copy the photos",
        ),
        ("crash", "The engine was killed", "Press the button again."),
        ("old", "The installed engine is older than this add-on, and cannot find cameras.", "Install the engine"),
    ],
)
def test_a_failure_is_told_with_what_to_do_about_the_photos(engine, photos, mode, message, hint):
    said, advice = searched(engine(mode), photos).failed.words()
    assert said.startswith(message.format(photos)) and advice.startswith(hint) and "Resume" not in advice
    assert not (photos / "transforms.json").exists()


def test_a_search_is_stopped_through_its_input(engine, photos, tmp_path):
    process = CameraProcess(engine("slow"), photos)
    wait_until(lambda: has_begun(process))
    assert not process.stopping
    process.stop()
    assert process.stopping
    wait_until(process.poll)
    assert json.loads((tmp_path / "stopped").read_text()) == {"cmd": "stop"}
    assert process.failed.code == STOPPED
    assert process.failed.words() == ("Stopped. No cameras were written", "Press the button again.")
    assert not (photos / "transforms.json").exists()


def test_an_engine_that_does_not_listen_is_terminated(engine, photos, tmp_path, monkeypatch):
    monkeypatch.setattr(engine_module, "STOP_GRACE_S", 0.1)
    process = CameraProcess(engine("deaf"), photos)
    wait_until((tmp_path / "waiting").exists)
    process.stop()
    wait_until(process.poll)
    assert process.failed.words() == ("Stopped. No cameras were written", "Press the button again.")


STARTER = """
import os, sys
sys.path.insert(0, {root!r})
from backend.engine.commands.camera_process import CameraProcess
from pathlib import Path
process = CameraProcess({python!r}, Path({photos!r}))
while not process.progress.fraction:
    assert not process.poll()
os.kill(os.getpid(), 9)
"""


def test_the_engine_ends_when_its_starter_is_killed(engine, photos, tmp_path):
    script = STARTER.format(root=str(ROOT), python=engine("slow"), photos=str(photos))
    starter = subprocess.run([sys.executable, "-c", script], timeout=LIMIT_S, stderr=subprocess.PIPE)
    assert starter.returncode == -9, starter.stderr
    wait_until(lambda: (tmp_path / "stopped").exists() and (tmp_path / "stopped").read_text())
    assert (tmp_path / "stopped").read_text() == "closed" and not (photos / "transforms.json").exists()


def test_a_python_without_the_engine_is_told_as_in_a_job(photos, tmp_path):
    failed = searched(bare_python(tmp_path), photos).failed
    assert failed.name == "engine.missing" and "lacks blender_nep" in failed.words()[0] and "Install" in failed.words()[1]
    with pytest.raises(NoEngineError, match="cannot be started"):
        CameraProcess(str(tmp_path / "no-python"), photos)


def test_a_read_only_folder_is_told_before_the_search(photos, tmp_path, monkeypatch):
    before = sorted(photos.iterdir())
    check_writable(photos)
    check_writable(tmp_path / "none")  # what is wrong with it, the engine says
    assert sorted(photos.iterdir()) == before

    def refused(**_):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(camera_process.tempfile, "TemporaryFile", refused)
    with pytest.raises(CameraError) as refusal:
        check_writable(photos)
    message, hint = refusal.value.words()
    assert message == f"{photos} may not be written ({os.strerror(errno.EROFS)})" and hint.startswith(
        "Change its permissions"
    )
    assert refusal.value.code == OUTPUT_FAILED


def test_hints_of_a_search_belong_to_errors_and_are_translated():
    assert set(words.CAMERA_HINTS) <= set(words.ERRORS)
    assert set(words.CAMERA_HINTS.values()) <= set(words.texts())
