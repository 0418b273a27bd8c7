"""Scores of an asset by held-out photos: which photos count, which pixels, and the gain. Nothing is rendered here."""

import json

import numpy as np
import pytest
from PIL import Image

pytest.importorskip("bpy")

from benchmarks.scoring import held_out
from blender_nep.errors import UsageError


@pytest.fixture
def asset(tmp_path):
    """asset(hold_out) is the folder of an asset without checkpoints, whose job held out one photo of so many.

    With `curve`, the job undid a camera's curve of this strength in the photos' files.
    """

    def make(hold_out, curve=None):
        capture = {"object_center": [0.3, -0.2, 0.5], "object_radius": 0.8, "masks": True, "exposure": 1.0}
        report = {
            "preset": "preview",
            "capture": capture if curve is None else capture | {"camera_curve": curve},
            "explained": {"hold_out": hold_out},
        }
        (tmp_path / "report.json").write_text(json.dumps(report))
        return tmp_path

    return make


def dimmed(gain, red=1.0):
    """Pictures of an asset that are the photos, divided by `gain`, and covered everywhere."""

    def render(_asset, _held, rays, _samples):
        pictures = []
        for number, (height, width) in enumerate(rays.size):
            photo = rays.radiance[rays.offset[number] : rays.offset[number + 1]].numpy().reshape(height, width, 3)
            shown = photo / gain * np.float32([red, 1, 1])
            pictures.append(np.concatenate([shown, np.ones((height, width, 1), np.float32)], 2))
        return pictures

    return render


def test_an_asset_that_looks_like_the_photos_scores_best(make_capture, asset, monkeypatch):
    folder = make_capture(masks=True).folder
    monkeypatch.setattr(held_out, "_render", dimmed(2.0))
    row = held_out.score(folder, asset(3))
    assert row["photos"] == 2 and row["hold_out"] == 3
    assert row["object_psnr"] == pytest.approx(100) and row["object_hue_deg"] == 0
    assert row["object_gains"] == [2.0, 2.0] and "surroundings_psnr" not in row
    monkeypatch.setattr(held_out, "_render", dimmed(2.0, red=0.5))
    assert held_out.score(folder, asset(3))["object_psnr"] < 25


def ramp_of_files(folder):
    """Make each photo a ramp of the files' values across the object. Returns it linear [24, 24, 3], by sRGB's formula."""
    ends = ((60, 220), (40, 180), (90, 140))
    value = np.stack([np.interp(np.arange(24), (6, 17), both) for both in ends], -1).round()
    ramp = np.broadcast_to(value.astype(np.uint8), (24, 24, 3))
    for file in (folder / "images").glob("*.png"):
        Image.fromarray(ramp).save(file)
    return ((ramp / 255 + 0.055) / 1.055) ** 2.4


def test_an_undone_curve_comes_back_in_renderings(make_capture, asset, monkeypatch):
    """The asset is the light before the camera's curve of strength 1: photo = 2.7 light^1.25 / (1 + 1.7 light^1.25)."""
    folder = make_capture(masks=True, suffix=".png").folder
    photo = ramp_of_files(folder)
    light = (photo / (2.7 - 1.7 * photo)) ** (1 / 1.25)
    picture = np.concatenate([light, np.ones((24, 24, 1))], 2).astype(np.float32)
    monkeypatch.setattr(held_out, "_render", lambda _asset, _held, rays, _samples: [picture] * len(rays.size))
    row = held_out.score(folder, asset(3, curve=1.0))
    assert row["object_psnr"] > 80 and row["object_gains"] == [1.0, 1.0] and row["object_hue_deg"] < 0.01
    without = held_out.score(folder, asset(3))
    assert without["object_psnr"] < 40 and without["object_hue_deg"] > 1


def test_photos_that_were_learned_from_are_refused(make_capture, asset):
    with pytest.raises(UsageError, match="learned from all photos"):
        held_out.score(make_capture(masks=True).folder, asset(None))
