"""Each example does what it says. The engine is real but for what is learned, which the stages of tests/support know."""

import json
import subprocess
import sys

import numpy as np
import pytest
from PIL import Image

from blender_nep.errors import UsageError
from blender_nep.job import runner
from examples.capture_to_asset import make_asset
from examples.correct_material import make_metal
from support.ball_stages import BallStages
from support.captures import write_exr
from support.paths import CHEAP_CYCLES, ROOT
from support.two_materials import KeepingStages

LIMIT_S = 400


def test_a_capture_becomes_an_asset(make_capture, tmp_path, monkeypatch):
    monkeypatch.setattr(runner, "Stages", BallStages)
    assert make_asset(make_capture(masks=True).folder, tmp_path / "asset") == 0
    assert json.loads((tmp_path / "asset" / "report.json").read_text())["preset"] == "preview"
    assert (tmp_path / "asset" / "asset.glb").is_file()
    assert make_asset(tmp_path / "missing", tmp_path / "none") == 3


def test_an_asset_is_shown_in_another_light(make_capture, tmp_path, monkeypatch):
    asset, light, picture = tmp_path / "asset", tmp_path / "red.exr", tmp_path / "picture.png"
    monkeypatch.setattr(runner, "Stages", BallStages)
    assert make_asset(make_capture(masks=True).folder, asset) == 0
    write_exr(light, np.tile(np.array([1.0, 0.0, 0.0], np.float32), (8, 16, 1)))
    command = [sys.executable, CHEAP_CYCLES, "-m", "examples.relight_asset", asset, light, picture]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=LIMIT_S)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    views = np.array(Image.open(picture)).reshape(160, 8, 160, 3).swapaxes(0, 1).astype(float)
    red, _, blue = views[:, 60:100, 60:100].mean((1, 2)).T
    assert (red > 50).all() and (blue < 5).all(), "the ball is in the middle of each view, and only the light is red"


def test_the_largest_material_becomes_a_metal(make_capture, tmp_path, monkeypatch):
    monkeypatch.setattr(runner, "Stages", KeepingStages)
    asset = tmp_path / "asset"
    assert make_asset(make_capture(masks=True).folder, asset) == 0
    shares = [material["share"] for material in json.loads((asset / "report.json").read_text())["materials"]]
    assert make_metal(asset, 0.3) == 0
    report = json.loads((asset / "report.json").read_text())
    assert report["corrections"] == {str(np.argmax(shares)): {"metallic": 1, "roughness": 0.3}}
    with pytest.raises(UsageError, match="holds no finished asset"):
        make_metal(tmp_path / "missing", 0.3)
