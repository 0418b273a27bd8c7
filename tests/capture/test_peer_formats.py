"""Cameras of programs that others use: known cameras come back, and files that are not read say whose they are."""

from pathlib import Path

import pytest
from PIL import Image

from blender_nep.capture import load_capture
from blender_nep.capture.foreign_cameras import foreign_cameras
from blender_nep.errors import CaptureError

FOREIGN = {
    "scan.psx": ("Metashape", "<document/>"),
    "scan.rcproj": ("RealityScan", ""),
    "job.mg": ("Meshroom", '{"header": {"pipelineVersion": "2.2"}}'),
    "sfm_data.bin": ("OpenMVG", ""),
    "scene.mvs": ("OpenMVS", "MVSI"),
    "a_calibrated_camera_parameters.txt": ("Pix4D", ""),
    "blocks.xml": ("iTwin Capture", '<?xml version="1.0"?><BlocksExchange version="3.2"/>'),
    "Barn.log": ("Tanks and Temples", "0 0 0\n1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n"),
    "0-camera.pkl": ("NeRO", ""),
    "frame_00000.json": ("3D Scanner App", '{"cameraPoseARFrame": []}'),
    "odometry.csv": ("Stray Scanner", ""),
}


def refused(folder: Path) -> CaptureError:
    with pytest.raises(CaptureError) as caught:
        load_capture(folder)
    return caught.value


@pytest.mark.parametrize("photos", [0, 3])
@pytest.mark.parametrize("name", FOREIGN)
def test_cameras_that_are_not_read_say_whose_they_are(tmp_path, name, photos):
    program, text = FOREIGN[name]
    (tmp_path / name).write_text(text)
    for number in range(photos):
        Image.new("RGB", (8, 6)).save(tmp_path / f"{number}.jpg")
    error = refused(tmp_path)
    assert (error.code, error.name) == (3, "capture.foreign_cameras")
    assert f"holds cameras of {program} ({name}) that cannot be read" in error.message
    assert (f"blender-nep cameras {tmp_path}" in error.hint) == (photos > 0)


@pytest.mark.parametrize("name", ["train.log", "blocks.xml", "job.mg", "0.xmp", "metadata.json", ".hidden.psx"])
def test_other_files_with_such_names_are_nobodys(tmp_path, name):
    (tmp_path / name).write_text("0 0 0\nstarted the search\n")
    assert foreign_cameras(tmp_path) is None
