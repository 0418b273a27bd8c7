"""run.py from the capture to a relit asset, with a scripted engine that learns nothing."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from backend.run import parse
from support.own_process import LIMIT_S, in_blender
from support.paths import ROOT, SUZANNE_SMALL
from support.waiting import wait_until


def start_run(engine_python: str, mode: str, out: Path, *options: str, asset: Path | None = None) -> subprocess.Popen:
    variables = os.environ | {"SCRIPTED_ENGINE": mode, "PYTHONPATH": "/nowhere", "BLENDER_USER_RESOURCES": str(out.parent)}
    if asset:
        variables["SCRIPTED_ASSET"] = str(asset)
    return subprocess.Popen(
        [
            sys.executable,
            ROOT / "backend" / "run.py",
            "--capture",
            SUZANNE_SMALL,
            "--out",
            out,
            "--engine-python",
            engine_python,
            *options,
        ],
        env=variables,
        text=True,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    )


def wait_for_file(path: Path, process: subprocess.Popen) -> None:
    def written() -> bool:
        assert process.poll() is None, process.communicate()[1]
        return path.exists()

    wait_until(written)


def test_an_error_of_the_engine_and_its_exit_code_are_passed_on(engine_python, tmp_path):
    options = ("--preset", "preview", "--masks", "ignore", "--threads", "2")
    sphere = ("--object-center", "0.5", "-0.00002", "2.0", "--object-radius", "1.5")
    process = start_run(engine_python, "refuse", tmp_path / "out", *options, *sphere)
    _, told = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 3
    assert "image 004.png is missing" in told and "Put it back." in told and "Traceback" not in told
    given = json.loads((tmp_path / "out" / "arguments.json").read_text())
    assert given[:2] == ["reconstruct", str(SUZANNE_SMALL)]
    assert [given[given.index(name) + 1] for name in options[::2]] == [*options[1::2]]
    passed = given[given.index("--object-center") :][:6]
    assert passed[::4] == [*sphere[::4]] and not any("e" in number for number in (*passed[1:4], passed[5]))
    assert [float(number) for number in (*passed[1:4], passed[5])] == [0.5, -2e-05, 2.0, 1.5]


@pytest.mark.parametrize(
    "options",
    [
        ("--capture", "x", "--object-radius", "1"),
        ("--capture", "x", "--object-center", "0", "0", "0"),
        ("--captures", "x", "--object-center", "0", "0", "0", "--object-radius", "1"),
    ],
)
def test_half_a_sphere_and_one_for_many_objects_are_refused(options, capsys):
    with pytest.raises(SystemExit) as ended:
        parse([*options, "--out", "y"])
    assert ended.value.code == 2 and "--object-center" in capsys.readouterr().err


@pytest.mark.parametrize("options", [["--capture", "x", "--out", ""], ["--capture", "", "--out", "y"]])
def test_an_empty_path_is_not_the_current_folder(options, capsys):
    with pytest.raises(SystemExit) as ended:
        parse(options)
    assert ended.value.code == 2 and "must not be empty" in capsys.readouterr().err


def test_a_comparison_replaces_no_photo(asset, make_capture):
    capture = make_capture(suffix=".png").folder
    photo = capture / "images" / "001.png"
    before = photo.read_bytes()
    command = [sys.executable, ROOT / "backend" / "render_comparison.py", "--asset", asset, "--capture", capture]
    process = subprocess.Popen([*command, "--out", photo], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert process.wait(LIMIT_S) == 8 and "choose another --out" in process.stdout.read()
    process.stdin.close()
    assert photo.read_bytes() == before


def test_a_killed_engine_is_reported(engine_python, tmp_path):
    process = start_run(engine_python, "crash", tmp_path / "out")
    _, told = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 128 + 9
    assert "was killed" in told and "the last words" in told


@pytest.mark.parametrize("how", ["SIGTERM", "closed stdin"])
def test_stopping_lets_the_engine_write_its_checkpoint(engine_python, tmp_path, how):
    process = start_run(engine_python, "wait", tmp_path / "out", "--watch-stdin")
    wait_for_file(tmp_path / "out" / "waiting", process)
    if how == "SIGTERM":
        process.send_signal(signal.SIGTERM)
    else:
        process.stdin.close()
        process.stdin = None
    _, told = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 7 and "checkpoint written" in told
    assert (tmp_path / "out" / "checkpoint").read_text() == "saved"


def test_an_engine_writes_a_checkpoint_when_its_parent_is_killed(engine_python, tmp_path):
    process = start_run(engine_python, "wait", tmp_path / "out")
    wait_for_file(tmp_path / "out" / "waiting", process)
    process.kill()
    process.communicate(timeout=LIMIT_S)
    wait_until((tmp_path / "out" / "checkpoint").exists)


@pytest.mark.slow
def test_run_relights_an_asset_and_a_done_one_needs_no_engine(engine_python, asset, tmp_path):
    """run.py from end to end: engine, import, World, comparison.png, asset.blend; then again without the engine."""
    out = tmp_path / "out"
    small = ("--relight", "1", "--photos", "1", "--samples", "2")
    process = start_run(engine_python, "asset", out, *small, asset=asset)
    _, told = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 0, told
    assert "Learning shape and light" in told and "done:" in told
    sheet = np.asarray(Image.open(out / "comparison.png"), np.float32)
    assert sheet.shape[1] > 3 * 320 and sheet.shape[0] > 320
    tiles = [sheet[-200:-20, 6 + k * 326 : 6 + k * 326 + 320] for k in range(3)]
    assert all(tile.std() > 5 for tile in tiles)
    assert sheet[:58].max() > 200, "titles are drawn"
    in_blender(check_saved_file, out / "asset.blend")
    assert not [path for path in out.iterdir() if "partial" in path.name]

    process = start_run(engine_python, "refuse", out, "--resume", *small)
    assert process.wait(timeout=LIMIT_S) == 0, "a finished asset needs no engine"
    (out / "environment.exr").write_bytes(b"torn")
    process = start_run(engine_python, "refuse", out, "--resume", *small)
    _, told = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 8 and "environment.exr" in told and "Traceback" not in told


def check_saved_file(path):
    import bpy

    bpy.ops.wm.open_mainfile(filepath=path)
    (scene,) = bpy.data.scenes
    assert scene.world.name == "recovered light" and scene.camera and scene.view_settings.view_transform == "Standard"
    assert len(bpy.data.worlds) == 2 and [item for item in scene.objects if item.type == "MESH"]
    used = [image for image in bpy.data.images if image.source == "FILE"]
    assert len(used) == 6 and all(image.packed_file for image in used)


def test_coordinates_of_a_report_can_be_given_again():
    options = parse(["--capture", "x", "--out", "y", "--object-center", "0", "-1e-05", "1", "--object-radius", "1"])
    assert options.object_center == [0, -1e-05, 1]


if __name__ == "__main__":
    globals()[sys.argv[1]](*sys.argv[2:])
