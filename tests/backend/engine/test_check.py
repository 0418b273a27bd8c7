"""The check of a Python names the parts of the engine that it has and those that it lacks."""

import platform
import sys

import torch

import blender_nep
from backend.engine.check import EngineCheck
from support.played_python import bare_python
from support.waiting import wait_until

LIMIT_S = 180


def answer(python: str) -> EngineCheck:
    check = EngineCheck(python)
    wait_until(check.poll, LIMIT_S)
    return check


def test_missing_parts_of_a_python_without_the_engine_are_named(tmp_path):
    lacking = answer(bare_python(tmp_path))
    assert not lacking.works and lacking.lines[0] == f"Python {platform.python_version()}"
    assert lacking.lines[-1].startswith("Missing: blender_nep, torch.")


def test_a_program_that_is_no_python_does_not_work():
    for program, message in (("/no/python", "/no/python cannot be started"), ("/bin/true", "/bin/true is no Python")):
        found = answer(program)
        assert not found.works and found.lines[0].startswith(message)


def test_a_python_that_does_not_answer_is_ended_with_advice(monkeypatch):
    monkeypatch.setattr("backend.engine.check.LIMIT_S", 0.0)
    found = EngineCheck(sys.executable)  # its imports take longer than no time
    process = found._process
    assert found.poll() and not found.works
    assert found.lines == ["It did not answer within 0 s.", "If the computer is busy, press Check again later."]
    assert process.returncode is not None, "the process still runs"


def test_versions_of_a_python_with_the_engine_are_named():
    found = answer(sys.executable)
    assert found.works, found.lines
    assert found.versions["torch"] == torch.__version__ and found.versions["blender_nep"] == blender_nep.__version__
