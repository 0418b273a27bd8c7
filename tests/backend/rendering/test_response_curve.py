"""Blender's side shows renderings with the same curve as the engine's photos have."""

import json

import numpy as np
import pytest
import torch

from backend.rendering.response_curve import seen_by_camera
from backend.scene_io.capture_files import read_frames, with_exposures
from blender_nep.capture.rays.response_curve import ResponseCurve

LIGHT = np.linspace(0, 3, 301).reshape(7, 43)


@pytest.mark.parametrize("strength", [0.0, 0.4, 1.0, 2.0])
def test_the_curve_is_the_engines(strength):
    curve = ResponseCurve.of(strength, 0.8, 0.2)
    expected = curve.photo(torch.from_numpy(LIGHT)).numpy()
    shown = seen_by_camera(LIGHT, (curve.strength, curve.white, curve.scale))
    np.testing.assert_allclose(shown, expected if strength else LIGHT, rtol=1e-12)
    assert seen_by_camera(LIGHT, None) is LIGHT


@pytest.mark.parametrize(
    ("response", "expected"),
    [
        ({"strength": 1.0, "white": 3.0, "scale": 6.0}, (1.0, 1.5, 3.0)),
        (None, None),
        ({"strength": 1.0, "white": 0.0, "scale": 6.0}, None),
        ({"strength": "1"}, None),
        ({"strength": float("inf"), "white": 1.0, "scale": 1.0}, None),
    ],
)
def test_the_report_tells_the_curve_in_the_photos_own_brightness(make_capture, tmp_path, response, expected):
    """The engine has seen these photos twice as bright."""
    tiny = make_capture(views=4, size=8)
    report = {
        "capture": {"views": 4, "exposure": 2.0, "photo_gains": [[1, 2, 1]] * 4},
        "stages": {"material_learning": {"response": response}},
    }
    (tmp_path / "report.json").write_text(json.dumps(report))
    frames = with_exposures(read_frames(tiny.folder), tmp_path)
    assert [frame.response for frame in frames] == [expected] * 4 and frames[0].gain == (1, 2, 1)
    assert all(frame.response is None for frame in with_exposures(read_frames(tiny.folder)[:3], tmp_path))


def test_the_curve_of_files_and_the_objects_gains_are_told(make_capture, tmp_path):
    tiny = make_capture(views=4, size=8)
    report = {
        "capture": {"views": 4, "camera_curve": 0.9, "photo_gains": [[1, 2, 1]] * 4},
        "stages": {"material_learning": {"object_gains": [1.0, 0.5, 2.0, 1.0]}},
    }
    (tmp_path / "report.json").write_text(json.dumps(report))
    frames = with_exposures(read_frames(tiny.folder), tmp_path)
    assert [frame.gain for frame in frames] == [(1, 2, 1)] * 4
    assert [frame.object_gain for frame in frames] == [1, 0.5, 2, 1], "the curve lies between both"
    assert all(frame.curve_of_files == (0.9, 1.0, 1.0) and frame.response is None for frame in frames)
    del report["capture"]["photo_gains"]
    (tmp_path / "report.json").write_text(json.dumps(report))
    frame = with_exposures(read_frames(tiny.folder), tmp_path)[2]
    assert frame.gain == (1, 1, 1) and frame.object_gain == 2
    report["stages"]["material_learning"]["object_gains"] = [1.0]
    (tmp_path / "report.json").write_text(json.dumps(report))
    frames = read_frames(tiny.folder)
    assert all(a is b for a, b in zip(with_exposures(frames, tmp_path), frames, strict=True)), "a report that does not fit"
