"""The engine's installation, with a Python that only plays venv and pip: what it makes, cleans up and reports."""

import json
import signal
import subprocess
import sys

import pytest
from packaging.requirements import Requirement

from backend.engine import install
from backend.engine.install import installed_python
from support.paths import ROOT
from support.played_python import played_python
from support.waiting import wait_until

LIMIT_S = 60


@pytest.fixture
def base(tmp_path):
    """A function that sets how the played Python behaves; base.python is its path."""

    def behave(mode):
        (tmp_path / "mode").write_text(mode)

    behave.python, behave.folder = played_python(tmp_path), tmp_path / "into"
    return behave


def begin(base, *options) -> subprocess.Popen:
    return subprocess.Popen(
        [
            sys.executable,
            "-I",
            install.__file__,
            "--source",
            ROOT,
            "--folder",
            base.folder,
            "--python",
            base.python,
            *options,
        ],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )


def end(process) -> tuple[int, list[dict]]:
    code = process.wait(LIMIT_S)  # its standard input stays open, because the program stops when it is closed
    return code, [json.loads(line) for line in process.stdout.read().splitlines()]


def test_an_installation_makes_an_engine_with_the_chosen_build(base, tmp_path):
    code, told = end(begin(base))
    assert code == 0 and told[-1]["event"] == "done" and told[-1]["torch"] == "2.9.9"
    assert installed_python(base.folder) == told[-1]["python"]
    fractions = [event["fraction"] for event in told[:-1]]
    assert fractions == sorted(fractions) and fractions[0] == 0 and fractions[-1] < 1
    torch, _, rest, _ = (tmp_path / "pip.txt").read_text().splitlines()
    assert "--index-url https://download.pytorch.org/whl/cpu" in torch and "--index-url" not in rest
    assert all("--constraint" in line and "--only-binary :all:" in line for line in (torch, rest))
    code, _ = end(begin(base, "--build", "cuda"))  # a second one in place of the first
    assert code == 0 and "--index-url" not in (tmp_path / "pip.txt").read_text().splitlines()[4]


@pytest.mark.parametrize("mode", ["well", "no compiler"])
def test_an_installation_compiles_the_kernels_if_it_can(base, mode, tmp_path):
    base(mode)
    code, told = end(begin(base))
    assert (code, told[-1]["event"]) == (0, "done") and (tmp_path / "compiled").exists()


def test_variables_of_pip_say_only_how_the_index_is_reached(base, tmp_path, monkeypatch):
    for name in (
        "PIP_TARGET",
        "PIP_PREFIX",
        "PIP_ROOT",
        "PIP_USER",
        "PIP_NO_BINARY",
        "PIP_CONSTRAINT",
        "PIP_INDEX_URL",
        "PIP_PROXY",
    ):
        monkeypatch.setenv(name, str(tmp_path / "elsewhere"))
    code, _ = end(begin(base))
    assert code == 0
    for line in (tmp_path / "pip.txt").read_text().splitlines()[1::2]:
        assert {"PIP_INDEX_URL", "PIP_PROXY"} <= set(line.split()) <= install.PIP_VARIABLES


def test_constraints_name_a_version_for_each_python():
    """Of numpy, the one of Python 3.11 has no builds for 3.13."""
    lines = [line for line in (ROOT / "constraints.txt").read_text().splitlines() if line and not line.startswith("#")]
    wanted = [Requirement(line) for line in lines]
    for version in ("3.11", "3.12", "3.13"):
        named = [one.name for one in wanted if one.marker is None or one.marker.evaluate({"python_version": version})]
        assert len(named) == len(set(named)) and {"numpy", "torch", "pillow"} <= set(named), version


@pytest.mark.parametrize(
    ("mode", "message", "hint"),
    [
        ("old 3 10", "is Python 3.10; the engine needs 3.11", "Base Python"),
        ("no venv", "lacks the module venv", "python3.12-venv"),
        ("new 3 14", "Python 3.14", "Choose another Base Python, for example 3.13"),
        ("no network", "The package index cannot be reached", "network connection"),
        ("no build", "no build of torch for this computer and Python 3.12", "3.13"),
        ("full", "The disk is full", "Free some"),
    ],
)
def test_an_installation_that_fails_says_why_and_leaves_nothing(base, mode, message, hint):
    base(mode)
    code, told = end(begin(base))
    assert code == 1 and message in told[-1]["message"] and hint in told[-1]["hint"]
    assert not installed_python(base.folder) and not (base.folder / "nep-engine").exists()


def test_a_base_python_that_does_not_exist_is_reported(base):
    base.python = "/no/python"
    code, told = end(begin(base))
    assert code == 1 and "/no/python cannot be started" in told[-1]["message"]


@pytest.mark.parametrize("how", ["stop", "closed"])
def test_a_cancelled_installation_leaves_nothing(base, tmp_path, how):
    """The add-on's button sends "stop". Standard input closes when Blender has ended."""
    base("slow")
    process = begin(base)
    wait_until((tmp_path / "slow").exists)
    if how == "stop":
        process.stdin.write('{"cmd": "stop"}\n')
        process.stdin.flush()
    else:
        process.stdin.close()
    code, told = end(process)
    assert code == 7 and "cancelled" in told[-1]["message"] and not (base.folder / "nep-engine").exists()


def test_a_killed_installation_counts_as_none_and_is_replaced(base, tmp_path):
    base("slow")
    process = begin(base)
    wait_until((tmp_path / "slow").exists)
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


@pytest.mark.parametrize("mode", ["no network", "full", "slow"])
def test_a_working_engine_comes_back_where_its_replacement_fails(base, tmp_path, mode):
    code, told = end(begin(base))
    assert code == 0
    base(mode)
    process = begin(base)
    if mode == "slow":
        wait_until((tmp_path / "slow").exists)
        process.stdin.close()
    assert end(process)[0] != 0
    assert installed_python(base.folder) == told[-1]["python"]
    assert [path.name for path in base.folder.iterdir()] == ["nep-engine"]


def test_an_engine_comes_back_after_its_replacement_was_killed(base, tmp_path):
    code, told = end(begin(base))
    assert code == 0
    base("slow")
    process = begin(base)
    wait_until((tmp_path / "slow").exists)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    base("no network")
    assert end(begin(base))[0] == 1 and installed_python(base.folder) == told[-1]["python"]
    base("well")
    assert end(begin(base))[0] == 0 and [path.name for path in base.folder.iterdir()] == ["nep-engine"]


@pytest.mark.parametrize("name", ["nep-engine.before", "nep-engine.unfinished"])
def test_a_folder_beside_the_engine_is_not_touched(base, name):
    theirs = base.folder / name / "thesis.txt"
    theirs.parent.mkdir(parents=True)
    theirs.write_text("years of work")
    assert end(begin(base))[0] == 0 and theirs.read_text() == "years of work"


def test_a_working_engine_is_back_before_anything_is_deleted(base, monkeypatch):
    code, told = end(begin(base))
    assert code == 0
    environment = base.folder / "nep-engine"
    install.set_aside(environment)
    environment.mkdir()
    (environment / "unfinished").touch()
    back = []

    def delete(folder, **_options) -> None:
        back.append(installed_python(base.folder))

    monkeypatch.setattr(install.shutil, "rmtree", delete)
    install.bring_back(environment)
    assert back and set(back) == {told[-1]["python"]}
    monkeypatch.undo()
    install.bring_back(environment)  # of the next run, after this one was killed while it deleted
    assert [path.name for path in base.folder.iterdir()] == ["nep-engine"] and installed_python(base.folder)
