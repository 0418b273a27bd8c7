"""A capture that is made from the cameras of another capture keeps what Blender's cameras lack."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from support.captures import look_at
from support.own_process import in_blender


@pytest.mark.parametrize(
    "lens",
    [
        {"k1": -0.2, "k2": 0.05, "p1": 0.001},
        {"camera_model": "OPENCV_FISHEYE", "k1": 0.02, "k4": -0.001},
        {"is_fisheye": True, "k1": 0.02},
        {"camera_model": "PINHOLE"},
    ],
)
def test_distortion_and_masks_survive_blender(tmp_path, lens):
    capture, frames = tmp_path / "capture", []
    (capture / "masks").mkdir(parents=True)
    for number in range(4):
        turn = np.pi * number / 2
        matrix = look_at(np.array([3 * np.cos(turn), 3 * np.sin(turn), 1.0]), np.zeros(3))
        for name, value in ((f"{number}.png", 100), (f"masks/{number}.png", 255)):
            Image.fromarray(np.full((32, 48, 3), value, np.uint8)).save(capture / name)
        frames.append(
            {"file_path": f"{number}.png", "mask_path": f"masks/{number}.png", "transform_matrix": matrix.tolist()}
        )
    meta = {"w": 48, "h": 32, "fl_x": 50.0, "cx": 25.0, "frames": frames, **lens}
    (capture / "transforms.json").write_text(json.dumps(meta))
    in_blender(check_copy, capture, tmp_path / "made", tmp_path / "moved")
    from blender_nep.capture import load_capture  # at the top, Blender would import torch, too, in two seconds

    before, after = (load_capture(folder) for folder in (tmp_path / "moved", tmp_path / "made"))
    assert len(after.views) == 4
    for old, new in zip(before.views, after.views, strict=True):
        assert new.camera.lens == old.camera.lens
        assert new.mask_path.resolve() == old.mask_path.resolve() and new.image_path.resolve() == old.image_path.resolve()
        np.testing.assert_allclose(new.camera.camera_to_world, old.camera.camera_to_world, atol=1e-6)
        np.testing.assert_allclose([new.camera.fl_x, new.camera.cx], [old.camera.fl_x, old.camera.cx], rtol=1e-5)


def check_copy(capture, made, moved):
    """The photos and masks are moved between both steps."""
    import bpy

    from backend.scene_io.capture_files import read_frames
    from backend.scene_io.photo_cameras import load_cameras
    from backend.scene_io.scene_capture import write_scene_capture

    bpy.ops.wm.read_factory_settings(use_empty=True)
    load_cameras(bpy.context.scene, Path(capture), read_frames(Path(capture)))
    bpy.context.view_layer.update()
    Path(capture).rename(moved)
    for camera in bpy.context.scene.objects:
        image = camera.data.background_images[0].image
        image.filepath = str(Path(moved) / Path(image.filepath).name)
    assert write_scene_capture(bpy.context.scene, Path(made)) == 4


if __name__ == "__main__":
    globals()[sys.argv[1]](*sys.argv[2:])
