"""The add-on in Blender: a whole session in the wheel at hand, and the arithmetic of its cameras."""

from __future__ import annotations

import io
import struct
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from blender_nep.job import runner as job
from blender_nep.job.events import Events
from blender_nep.presets import preset
from blender_nep.stop_request import StopRequest
from support import extension
from support.ball_stages import BallStages
from support.own_process import run_file

LIMIT_S = 300


def test_an_artists_session(make_capture, tmp_path):
    """See blender_session.py. Asset and engine are real but for what was learned, which BallStages knows."""
    capture, asset = make_capture(masks=True).folder, tmp_path / "ball"
    settings = job.Settings(capture, asset, preset("preview"))
    assert job.run(settings, Events(None, io.StringIO()), StopRequest(), BallStages()) == 0
    archive = extension.build(tmp_path / "blender_nep.zip")
    ended = extension.session(sys.executable, sys.executable, archive, capture, asset, tmp_path / "session", LIMIT_S)
    assert ended.returncode == 0, ended.stdout[-5000:]
    assert "all of it works" in ended.stdout


def in_blender(function) -> None:
    done = run_file(__file__, function.__name__, timeout=LIMIT_S)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-4000:]


def test_a_cameras_intrinsics_are_what_blender_projects():
    in_blender(check_intrinsics)


def check_intrinsics():
    """Every sensor fit, wide and tall frames, shifts and pixels that are no squares, against Blender's projection."""
    import bpy
    from bpy_extras.object_utils import world_to_camera_view
    from mathutils import Vector

    from backend.scene_io.cameras import intrinsics

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene, rng = bpy.context.scene, np.random.default_rng(0)
    data = bpy.data.cameras.new("camera")
    camera = bpy.data.objects.new("camera", data)
    scene.collection.objects.link(camera)
    data.sensor_width, data.sensor_height, data.lens = 31.0, 23.0, 40.0
    data.shift_x, data.shift_y = 0.07, -0.11
    for fit in ("AUTO", "HORIZONTAL", "VERTICAL"):
        for size in ((160, 90), (90, 160), (100, 100)):
            for aspect in ((1.0, 1.0), (1.0, 1.3), (2.0, 1.0)):
                data.sensor_fit = fit
                scene.render.resolution_x, scene.render.resolution_y = size
                scene.render.pixel_aspect_x, scene.render.pixel_aspect_y = aspect
                bpy.context.view_layer.update()
                lens = intrinsics(data, *size, aspect)
                for point in np.c_[rng.uniform(-1, 1, (4, 2)), rng.uniform(-6, -2, 4)]:
                    x, y, _ = world_to_camera_view(scene, camera, Vector(point))
                    expected = lens.cx + lens.fl_x * point[0] / -point[2], lens.cy - lens.fl_y * point[1] / -point[2]
                    np.testing.assert_allclose((x * size[0], (1 - y) * size[1]), expected, atol=1e-3)


@pytest.mark.parametrize("name", ["a.png", "a.jpg", "progressive.jpg", "a.exr"])
def test_image_size_of_a_header(tmp_path, name):
    from backend.scene_io.image_size import image_size
    from support.captures import write_exr

    pixels = np.zeros((7, 13, 3))
    if name.endswith("exr"):
        write_exr(tmp_path / name, pixels)
    else:
        keywords = {"progressive": True} if name.startswith("progressive") else {}
        Image.fromarray(pixels.astype(np.uint8)).save(tmp_path / name, **keywords)
    assert image_size(tmp_path / name) == (13, 7)
    (tmp_path / name).write_bytes((tmp_path / name).read_bytes()[:18])
    with pytest.raises(OSError, match="damaged"):
        image_size(tmp_path / name)


def test_text_is_no_image(tmp_path):
    from backend.scene_io.image_size import image_size

    (tmp_path / "a.png").write_bytes(struct.pack(">I", 1) + b"hello")
    with pytest.raises(OSError, match="no PNG"):
        image_size(tmp_path / "a.png")


def test_the_zip_holds_what_the_extension_needs_and_no_more(tmp_path):
    import zipfile

    names = set(zipfile.ZipFile(extension.build(tmp_path / "a.zip")).namelist())
    assert {
        "blender_manifest.toml",
        "__init__.py",
        "addon/__init__.py",
        "backend/render_comparison.py",
        "backend/run.py",
    } <= names
    assert not [
        name
        for name in names
        if Path(name).parts[0] in ("tests", "data", "docs", "out", "benchmarks")
        or "__pycache__" in name
        or name.startswith(".")
    ]


if __name__ == "__main__":
    globals()[sys.argv[1]]()
