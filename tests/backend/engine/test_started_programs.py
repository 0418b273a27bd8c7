"""Programs that are started open no console windows on Windows, and run nothing from the current folder."""

import ast
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from backend.engine import command, install
from backend.engine.check import EngineCheck
from backend.engine.commands.capture_query import CaptureQuery
from backend.engine.commands.gallery_process import GalleryProcess
from backend.engine.engine import Engine
from backend.engine.started_process import StartedProcess
from blender_nep.safety import isolated_python
from support.executable import write_executable
from support.paths import ROOT
from support.waiting import wait_until

NEUTRAL = os.path.abspath(os.sep)
TELL = """
import json, os, sys
with open({told!r}, "w") as told:
    json.dump([os.getcwd(), sys.argv[1:]], told)
"""
STARTS = {"Popen", "run", "call", "check_call", "check_output"}


def starts_of(path: Path) -> list[ast.Call]:
    """The calls of `subprocess` in a file that start a program."""
    calls = [node for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.Call)]
    named = [call for call in calls if isinstance(call.func, ast.Attribute) and isinstance(call.func.value, ast.Name)]
    return [call for call in named if call.func.value.id == "subprocess" and call.func.attr in STARTS]


@pytest.mark.parametrize("folder", ["addon", "backend"])
def test_no_program_opens_a_window(folder):
    found = [(path, call) for path in sorted((ROOT / folder).rglob("*.py")) for call in starts_of(path)]
    assert found or folder == "addon"
    opens = [
        f"{path.relative_to(ROOT)}:{call.lineno}"
        for path, call in found
        if "creationflags" not in {keyword.arg for keyword in call.keywords}
    ]
    assert not opens, "without CREATE_NO_WINDOW"


@pytest.mark.parametrize("folder", ["addon", "backend", "blender_nep", "benchmarks"])
def test_every_program_gets_a_current_folder(folder):
    """The user's own one may hold files of strangers."""
    found = [(path, call) for path in sorted((ROOT / folder).rglob("*.py")) for call in starts_of(path)]
    without = [
        f"{path.relative_to(ROOT)}:{call.lineno}"
        for path, call in found
        if "NEUTRAL_FOLDER" not in [ast.unparse(one.value) for one in call.keywords if one.arg == "cwd"]
    ]
    assert not without and (found or folder == "addon")


def test_both_sides_have_the_same_neutral_folder():
    assert install.NEUTRAL_FOLDER == isolated_python.NEUTRAL_FOLDER == NEUTRAL


def is_this_python(node: ast.expr) -> bool:
    return ast.unparse(node) in ("sys.executable", "python", "str(python)", "options.python", "whole_path(python)")


@pytest.mark.parametrize("folder", ["addon", "backend", "blender_nep", "benchmarks"])
def test_every_python_is_isolated(folder):
    """A command is a list or tuple that begins with a Python. The function `isolated_python` itself chooses the options."""
    nodes = [
        (path, node)
        for path in sorted((ROOT / folder).rglob("*.py"))
        if path.name != "isolated_python.py"
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
    ]
    commands = [
        (path, node)
        for path, node in nodes
        if isinstance(node, ast.List | ast.Tuple) and len(node.elts) > 1 and is_this_python(node.elts[0])
    ]
    isolated = ("'-I'", "*PIP")
    plain = [
        f"{path.relative_to(ROOT)}:{node.lineno}" for path, node in commands if ast.unparse(node.elts[1]) not in isolated
    ]
    assert not plain and (commands or folder in ("blender_nep", "benchmarks")) and install.PIP[0] == "-I"


def check(python: str) -> None:
    wait_until(EngineCheck(python).poll)


def find(python: str) -> None:
    assert command._has_engine(python)


def ask(python: str) -> None:
    query = CaptureQuery(Path("photos"), python)
    wait_until(query.poll)
    query.close()


def reconstruct(python: str) -> None:
    engine = Engine.start(python, command.reconstruct_arguments("photos", "out", mesh="known.obj"))
    wait_until(lambda: engine.poll()[1])
    engine.close()


def start_batch(python: str) -> None:
    engine = Engine.start(python, command.batch_arguments(["photos", "vases"], "out"))
    wait_until(lambda: engine.poll()[1])
    engine.close()


def write_gallery(python: str) -> None:
    wait_until(GalleryProcess(python, Path("out")).poll)


def start(python: str) -> None:
    process = StartedProcess([python, "-I"])
    wait_until(lambda: not process.running())
    process.close()


PATHS = {ask: ["photos"], reconstruct: ["photos", "out", "known.obj"], start_batch: ["photos", "vases", "out"]}


@pytest.mark.parametrize("begin", [check, find, ask, reconstruct, start_batch, write_gallery, start])
def test_blender_starts_the_engine_in_a_neutral_folder(begin, tmp_path, monkeypatch):
    """Relative paths of the user are those of the user's folder all the same, also that of the Python."""
    told = tmp_path / "told.json"
    write_executable(tmp_path / "python", TELL.format(told=str(told)))
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv(command.ENGINE_PYTHON_VARIABLE, raising=False)
    begin(command.find_engine_python("./python"))
    where, arguments = json.loads(told.read_text())
    assert where == NEUTRAL and arguments[0] == "-I"
    expected = {str(tmp_path / name) for name in PATHS.get(begin, ["out"] if begin is write_gallery else [])}
    assert expected <= set(arguments)


def test_the_installer_starts_pip_in_a_neutral_folder(tmp_path):
    """It is given the Python by a relative path."""
    told = tmp_path / "told.json"
    write_executable(tmp_path / "python", TELL.format(told=str(told)))
    arguments = ["--source", "source", "--folder", "folder", "--python", "./python"]
    program = [sys.executable, "-I", install.__file__, *arguments]
    with subprocess.Popen(program, cwd=tmp_path, stdin=subprocess.PIPE) as installer:  # it would stop without standard input
        assert installer.wait(60)
    assert json.loads(told.read_text())[0] == NEUTRAL
