"""Which parts of the engine a Python has."""

import stat
import sys
import time

import torch

import blender_nep
from backend.engine.check import EngineCheck

LIMIT_S = 180


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


def test_a_python_with_the_engine_works():
    found = answer(sys.executable)
    assert found.works, found.lines
    assert found.versions["torch"] == torch.__version__ and found.versions["blender_nep"] == blender_nep.__version__
