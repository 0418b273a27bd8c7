"""Which Python runs the engine, in which environment, with which arguments."""

import pytest

from backend.engine.command import (
    ENGINE_PYTHON_VARIABLE,
    LEAST_FACES,
    engine_environment,
    engine_is_at_hand,
    find_engine_python,
    reconstruct_arguments,
)
from blender_nep import cli, command_line


def test_a_python_that_is_named_is_taken_in_order(monkeypatch):
    monkeypatch.delenv(ENGINE_PYTHON_VARIABLE, raising=False)
    assert find_engine_python(configured="/configured") == "/configured" and engine_is_at_hand("/configured")
    monkeypatch.setenv(ENGINE_PYTHON_VARIABLE, "/from/the/variable")
    assert find_engine_python(configured="/configured") == "/from/the/variable" and engine_is_at_hand("")
    assert find_engine_python("/named", "/configured") == "/named"


def test_the_engine_does_not_get_blenders_variables(monkeypatch):
    for name in ("PYTHONPATH", "PYTHONHOME", "BLENDER_USER_RESOURCES"):
        monkeypatch.setenv(name, "/nowhere")
    monkeypatch.setenv("HTTP_PROXY", "http://proxy")
    found = engine_environment()
    assert not [name for name in found if name.startswith(("PYTHON", "BLENDER_"))] and found["HTTP_PROXY"] == "http://proxy"


@pytest.mark.parametrize("keep_going", [True, False])
def test_only_what_was_chosen_is_handed_on(keep_going):
    found = reconstruct_arguments(
        "/photos", "/out", seed=0, metal="yes", resume=True, keep_going=keep_going, more=("--x", "1")
    )
    assert found[:4] == ["reconstruct", "/photos", "--out", "/out"]
    assert found[found.index("--seed") + 1] == "0" and found[found.index("--metal") + 1] == "yes"
    assert "--resume" in found and found[found.index("--x") + 1] == "1"
    assert ("--watch-stdin" in found) is not keep_going
    assert not {"--preset", "--masks", "--mesh", "--threads", "--overwrite", "--preview"} & set(found)


def test_the_engine_understands_every_argument():
    found = command_line.parser().parse_args(
        reconstruct_arguments(
            "photos",
            "out",
            preset="quality",
            device="cpu",
            seed=3,
            masks="ignore",
            metal="no",
            turntable="yes",
            faces=5000,
            threads=2,
            resume=True,
            overwrite=True,
            preview=True,
        )
    )
    assert (found.preset, found.device, found.seed, found.masks, found.metal) == ("quality", "cpu", 3, "ignore", "no")
    assert found.faces == 5000 and found.threads == 2 and found.turntable == "yes"
    assert found.resume and found.overwrite and found.preview and found.watch_stdin and found.job_files
    known = command_line.parser().parse_args(reconstruct_arguments("/photos", "/out", mesh="/known.obj"))
    assert str(known.mesh) == "/known.obj" and known.faces is None


def test_both_sides_know_the_smallest_number_of_faces(capsys):
    assert LEAST_FACES == command_line.LEAST_FACES
    few = reconstruct_arguments("photos", "out", faces=LEAST_FACES - 1)
    with pytest.raises(SystemExit) as refused:
        command_line.parser().parse_args(few)
    assert refused.value.code == 2 and f"at least {LEAST_FACES}" in capsys.readouterr().err
    with pytest.raises(SystemExit) as refused:
        cli.main(reconstruct_arguments("photos", "out", faces=LEAST_FACES, mesh="known.obj"))
    assert refused.value.code == 2 and "--faces does not work with --mesh" in capsys.readouterr().err
