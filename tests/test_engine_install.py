"""The engine's installation, with a Python that only plays venv and pip: what it makes, cleans up, and says."""

import json
import os
import signal
import stat
import subprocess
import sys
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from backend.engine import install as engine_install  # noqa: E402
from backend.engine.check import EngineCheck  # noqa: E402
from backend.engine.install import installed_python  # noqa: E402

LIMIT_S = 60

PLAYED = """#!{python}
import os, pathlib, shutil, sys, time
mode = pathlib.Path({folder!r}, "mode").read_text()
what = sys.argv[2:]
if what[0] == "-c" and "version_info" in what[1]:
    print("version", *mode.split()[1:] if mode.startswith("old") else (3, 12))
    sys.exit("No module named 'ensurepip'" if mode == "no venv" else 0)
if what[0] == "-c":
    print("versions 2.9.9 0.1.0")
elif what[:2] == ["-m", "venv"]:
    place = pathlib.Path(what[2], *{place!r})
    place.parent.mkdir(parents=True)
    shutil.copy(__file__, place)
elif what[:3] == ["-m", "pip", "install"]:
    with open({folder!r} + "/pip.txt", "a") as told:
        print(*what[3:], file=told)
    print("Collecting something", flush=True)
    if mode == "slow":
        pathlib.Path({folder!r}, "slow").touch()
        time.sleep(600)
    if mode == "no build" and "torch" in what:
        sys.exit("ERROR: No matching distribution found for torch")
    if mode == "full":
        sys.exit("ERROR: Could not install packages due to an OSError: [Errno 28] No space left on device")
    sources = [item for item in what if "nep_source_" in item]
    assert not sources or pathlib.Path(sources[0], "blender_nep", "cli.py").is_file()
"""


def played_python(folder: Path) -> str:
    """Makes the played Python; the file `mode` beside it says how it behaves."""
    place = ("Scripts", "python.exe") if os.name == "nt" else ("bin", "python")
    path = folder / "base-python"
    path.write_text(PLAYED.format(python=sys.executable, folder=str(folder), place=place))
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    (folder / "mode").write_text("well")
    return str(path)


@pytest.fixture
def base(tmp_path):
    """A function that sets how the played Python behaves; base.python is its path."""

    def behave(mode):
        (tmp_path / "mode").write_text(mode)

    behave.python, behave.folder = played_python(tmp_path), tmp_path / "into"
    return behave


def begin(base, *options) -> subprocess.Popen:
    return subprocess.Popen([sys.executable, "-I", engine_install.__file__, "--source", ROOT, "--folder", base.folder,
                             "--python", base.python, *options], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                            stderr=subprocess.DEVNULL, text=True)


def end(process) -> tuple[int, list[dict]]:
    code = process.wait(LIMIT_S)  # its standard input stays open: else it would stop
    return code, [json.loads(line) for line in process.stdout.read().splitlines()]


def wait_for(path: Path) -> None:
    deadline = time.monotonic() + LIMIT_S
    while not path.exists():
        assert time.monotonic() < deadline
        time.sleep(0.02)


def test_an_engine_is_made(base, tmp_path):
    code, told = end(begin(base))
    assert code == 0 and told[-1]["event"] == "done" and told[-1]["torch"] == "2.9.9"
    assert installed_python(base.folder) == told[-1]["python"]
    fractions = [event["fraction"] for event in told[:-1]]
    assert fractions == sorted(fractions) and fractions[0] == 0 and fractions[-1] < 1
    torch, rest = (tmp_path / "pip.txt").read_text().splitlines()
    assert "--index-url https://download.pytorch.org/whl/cpu" in torch and "--index-url" not in rest
    assert "--constraint" not in torch + rest, "the constraints are those of Python 3.11"
    code, _ = end(begin(base, "--build", "cuda"))  # a second one in place of the first
    assert code == 0 and "--index-url" not in (tmp_path / "pip.txt").read_text().splitlines()[2]


@pytest.mark.parametrize(("mode", "message", "hint"), [
    ("old 3 10", "is Python 3.10; the engine needs 3.11", "Base Python"),
    ("no venv", "lacks the module venv", "python3.12-venv"),
    ("no build", "no build of torch for this computer and Python 3.12", "3.13"),
    ("full", "The disk is full", "Free some"),
])
def test_what_cannot_be_is_said_and_nothing_is_left(base, mode, message, hint):
    base(mode)
    code, told = end(begin(base))
    assert code == 1 and message in told[-1]["message"] and hint in told[-1]["hint"]
    assert not installed_python(base.folder) and not (base.folder / "nep-engine").exists()


def test_a_python_that_is_none_is_said(base):
    base.python = "/no/python"
    code, told = end(begin(base))
    assert code == 1 and "/no/python cannot be started" in told[-1]["message"]


@pytest.mark.parametrize("how", ["stop", "closed"])
def test_a_cancelled_installation_leaves_nothing(base, tmp_path, how):
    """By the button, or because Blender is gone."""
    base("slow")
    process = begin(base)
    wait_for(tmp_path / "slow")
    if how == "stop":
        process.stdin.write('{"cmd": "stop"}\n')
        process.stdin.flush()
    else:
        process.stdin.close()
    code, told = end(process)
    assert code == 7 and "cancelled" in told[-1]["message"] and not (base.folder / "nep-engine").exists()


def test_a_killed_installation_looks_like_none_and_is_made_anew(base, tmp_path):
    base("slow")
    process = begin(base)
    wait_for(tmp_path / "slow")
    process.send_signal(signal.SIGKILL)
    process.communicate()
    assert (base.folder / "nep-engine").exists() and not installed_python(base.folder)
    base("well")
    code, _ = end(begin(base))
    assert code == 0 and installed_python(base.folder)


def test_somebody_elses_folder_is_not_touched(base):
    theirs = base.folder / "nep-engine" / "thesis.txt"
    theirs.parent.mkdir(parents=True)
    theirs.write_text("years of work")
    code, told = end(begin(base))
    assert code == 1 and "is no engine" in told[-1]["message"] and theirs.read_text() == "years of work"


def answer(python: str) -> EngineCheck:
    check, deadline = EngineCheck(python), time.monotonic() + LIMIT_S
    while not check.poll():
        assert time.monotonic() < deadline
        time.sleep(0.02)
    return check


def test_a_check_says_what_is_there_and_what_is_missing(tmp_path):
    bare = tmp_path / "bare-python"
    bare.write_text(f'#!/bin/sh\nexec {sys.executable} -S "$@"\n')
    bare.chmod(bare.stat().st_mode | stat.S_IXUSR)
    lacking = answer(str(bare))
    assert not lacking.works and lacking.lines[-1].startswith("Missing: blender_nep, torch.")
    assert "cannot be started" in answer("/no/python").lines[0]
    assert "is no Python" in answer("/bin/true").lines[0]
