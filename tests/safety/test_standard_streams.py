"""Streams that are closed or that nobody reads, and options beyond all measure, end in no traceback."""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
import threading

import numpy as np
import pytest

from blender_nep.cameras import photo_folder
from blender_nep.capture import description
from blender_nep.capture.loading import describe
from blender_nep.cli import main
from blender_nep.errors import CaptureError
from blender_nep.stop_request import INPUT_CLOSED, StopRequest
from support.batch_folder import write_batch
from support.camera_exports import (
    known_cameras,
    write_bundler,
    write_cameras_sphere,
    write_llff,
    write_metashape,
    write_photos,
)
from support.paths import ROOT

LIMIT_S = 120
linux = pytest.mark.skipif(sys.platform != "linux", reason="/dev/full is of Linux")
posix = pytest.mark.skipif(os.name == "nt", reason="a shell of POSIX")


def in_shell(command: str, *arguments: object) -> subprocess.CompletedProcess:
    """Run a shell's line, in which NEP stands for this program with the arguments."""
    whole = shlex.join([sys.executable, "-m", "blender_nep", *map(str, arguments)])
    line = f"set -o pipefail; {command.replace('NEP', whole)}"
    return subprocess.run(["bash", "-c", line], cwd=ROOT, capture_output=True, text=True, timeout=LIMIT_S)


@posix
@pytest.mark.parametrize(
    ("command", "code", "said"),
    [
        ("NEP >&-", 0, ""),
        ("NEP | true", 0, ""),
        ("NEP <&- >&- 2>&-", 0, ""),
        pytest.param("NEP > /dev/full", 5, "error: the disk is full", marks=linux),
    ],
)
def test_output_that_goes_nowhere(command, code, said, tmp_path):
    """The gallery is the command that starts fastest."""
    ended = in_shell(command, "gallery", write_batch(tmp_path / "shelf", []))
    assert ended.returncode == code and "Traceback" not in ended.stderr and "Exception" not in ended.stderr
    assert said in ended.stderr


@posix
def test_info_that_nobody_reads(make_capture):
    ended = in_shell("NEP | true", "info", make_capture().folder)
    assert ended.returncode == 0 and not ended.stderr


C_PRINTS = """
import ctypes
from blender_nep.safety.standard_streams import prints_go_to_errors
with prints_go_to_errors():
    ctypes.CDLL(None).printf(b"warning\\n")
print("{}")
"""


@posix
def test_what_c_libraries_print_waits_in_no_buffer():
    buffered = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    done = subprocess.run([sys.executable, "-c", C_PRINTS], env=buffered, cwd=ROOT, capture_output=True, text=True)
    assert (done.stdout, done.stderr) == ("{}\n", "warning\n")


@posix
def test_a_job_without_standard_streams_ends_as_with_them(make_capture, tmp_path):
    """It is refused, because two photos are too few."""
    ended = in_shell(
        "NEP <&- >&- 2>&-", "reconstruct", make_capture(views=2).folder, "--out", tmp_path / "out", "--preset", "preview"
    )
    assert ended.returncode == 3 and not ended.stderr


@posix
def test_a_closed_input_that_is_watched_asks_for_a_stop(make_capture, tmp_path):
    out = tmp_path / "out"
    ended = in_shell(
        "NEP <&-", "reconstruct", make_capture(views=8).folder, "--out", out, "--watch-stdin", "--preset", "preview"
    )
    assert ended.returncode == 7 and "Traceback" not in ended.stderr and not (out / "report.json").exists()


def test_a_closed_descriptor_asks_for_a_stop():
    reading, writing = os.pipe()
    os.close(writing)
    os.close(reading)
    stop, failed = StopRequest(), []
    before, threading.excepthook = threading.excepthook, failed.append
    try:
        stop.watch(reading)
        for _ in range(500):
            if stop.requested:
                break
            threading.Event().wait(0.01)
    finally:
        threading.excepthook = before
    assert stop.requested and stop.reason == INPUT_CLOSED and not failed


@pytest.mark.parametrize("option", [["--threads", "100000000"], ["--threads", "1025"], ["--threads", "0"]])
@pytest.mark.parametrize("command", [["reconstruct", "c", "--out", "o"], ["cameras", "c"], ["batch", "c", "--out", "o"]])
def test_threads_have_a_limit(command, option, capsys):
    with pytest.raises(SystemExit) as ended:
        main([*command, *option])
    assert ended.value.code == 2 and "must be at" in capsys.readouterr().err


def test_ray_without_ray_says_what_to_install(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr("blender_nep.cli.find_spec", lambda name: None)
    with pytest.raises(SystemExit) as ended:
        main(["batch", str(tmp_path), "--out", str(tmp_path / "out"), "--ray", "auto"])
    assert ended.value.code == 2 and "blender-nep[cluster]" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


WRITERS = {
    "llff": lambda folder: write_llff(folder, known_cameras()),
    "cameras_sphere": lambda folder: write_cameras_sphere(folder, known_cameras(square=False)),
    "metashape": lambda folder: write_metashape(folder, known_cameras()),
    "bundler": lambda folder: write_bundler(folder, known_cameras(centered=True)),
}


@pytest.mark.parametrize("name", WRITERS)
def test_a_capture_has_a_largest_number_of_photos(name, monkeypatch, tmp_path):
    WRITERS[name](tmp_path)
    assert len(describe(tmp_path).views) == 4
    for module in (description, sys.modules["blender_nep.capture.formats.llff"]):
        monkeypatch.setattr(module, "MOST_VIEWS", 3)
    with pytest.raises(CaptureError, match=r"at most 3 are possible|cannot be read \(it holds"):
        describe(tmp_path)


def test_so_have_transforms_and_a_folder_of_photos(make_capture, monkeypatch, tmp_path):
    capture = make_capture(views=4)
    write_photos(tmp_path / "photos")
    monkeypatch.setattr(description, "MOST_VIEWS", 3)
    with pytest.raises(CaptureError, match=r"transforms.json lists 4 photos: at most 3"):
        describe(capture.folder)
    with pytest.raises(CaptureError, match="lists 4 photos: at most 3"):
        photo_folder.find_photos(tmp_path / "photos")


def test_a_million_frames_are_refused_at_once(make_capture):
    """Without the limit, each photo would be looked for on the disk: that took 15 minutes."""
    capture = make_capture()
    frame = json.dumps(capture.meta["frames"][0])
    frames = ",".join(np.repeat(frame, 50_000))
    (capture.folder / "transforms.json").write_text('{"frames": [' + frames + "]}")
    with pytest.raises(CaptureError, match="lists 50,000 photos"):
        describe(capture.folder)
