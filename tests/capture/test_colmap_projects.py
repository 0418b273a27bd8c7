"""COLMAP projects as people have them: text that scripts wrote, workspaces of other programs, rigs and frames."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from blender_nep.capture import load_capture
from blender_nep.capture.formats import colmap
from blender_nep.errors import CaptureError

NAMES = ["a.png", "b c.png", "d/e.png", "0004"]
SIZE = (32, 24)


def pose_line(number: int, camera: int = 1) -> str:
    turn = 1.3 * number
    return f"{number + 1} {np.cos(turn)} 0 {np.sin(turn)} 0 0.1 -0.2 {3 + number} {camera} {NAMES[number]}"


def model(folder: Path, place: str = "sparse/0", lines: list[str] | None = None, size=SIZE, focal: float = 30) -> None:
    (folder / place).mkdir(parents=True)
    text = f"# cameras\n1 PINHOLE {size[0]} {size[1]} {focal} {focal} {size[0] / 2} {size[1] / 2}\n"
    (folder / place / "cameras.txt").write_text(text)
    both = [line for number in range(4) for line in (pose_line(number), "")]
    (folder / place / "images.txt").write_text("\n".join(both if lines is None else lines) + "\n")


def photos(folder: Path, place: str = "images", size=SIZE) -> None:
    for name in NAMES:
        path = folder / place / (name if "." in name else f"{name}.png")
        path.parent.mkdir(parents=True, exist_ok=True)
        Image.new("RGB", size).save(path)


POSES = [pose_line(number) for number in range(4)]
FEATURES = "9.5 213.25 -1 12 13.5 77"
WHOLE = "1 2 -1 3 4 5 6 7 8 9 10 11"
TEXTS = {
    "two lines a photo": [line for pose in POSES for line in (pose, FEATURES)],
    "empty lines of features": [line for pose in POSES for line in (pose, "")],
    "no lines of features": POSES,
    "an empty first line": ["", "# images", *(line for pose in POSES for line in (pose, ""))],
    "comments in between": [line for pose in POSES for line in ("# next", pose, FEATURES)],
    "some lines of features": [POSES[0], FEATURES, POSES[1], POSES[2], FEATURES, POSES[3]],
    "features at whole pixels": [line for pose in POSES for line in (pose, WHOLE)],
    "ends of lines of Windows": [f"{line}\r" for pose in POSES for line in (pose, "")],
    "a byte order mark": ["\ufeff# images", *(line for pose in POSES for line in (pose, ""))],
    "indented": [f"  {line}" for pose in POSES for line in (pose, FEATURES)],
}


@pytest.mark.parametrize("case", TEXTS)
def test_every_photo_of_the_text_is_read(tmp_path, case):
    model(tmp_path, lines=TEXTS[case])
    photos(tmp_path)
    said = colmap.read(tmp_path)
    assert [view.name for view in said.views] == ["0004", "a", "b c", "d/e"] and not said.warnings
    heights = {view.name: view.camera.position for view in said.views}
    assert np.linalg.norm(heights["d/e"]) == pytest.approx(np.linalg.norm([0.1, 0.2, 5]))


def test_a_line_that_is_no_pose_is_named(tmp_path):
    model(tmp_path, lines=[POSES[0], "", "1 0 0 zero", ""])
    photos(tmp_path)
    with pytest.raises(CaptureError, match="has the line '1 0 0 zero'"):
        colmap.read(tmp_path)


WORKSPACES = {
    "COLMAP's automatic reconstruction": ([("sparse/0", None), ("dense/0/sparse", "dense/0/images")], "dense/0/images"),
    "dense alone": ([("dense/0/sparse", "dense/0/images")], "dense/0/images"),
    "dense without a number": ([("dense/sparse", "dense/images")], "dense/images"),
    "undistorted": ([("undistorted/sparse/0", "undistorted/images")], "undistorted/images"),
    "3DGS": ([("sparse/0", "images"), ("distorted/sparse/0", "input")], "images"),
    "3DGS before it is undistorted": ([("distorted/sparse/0", "input")], "input"),
    "3DGS whose undistorted photos are gone": ([("sparse/0", None), ("distorted/sparse/0", "input")], "input"),
    "nerfstudio": ([("colmap/sparse/0", "images")], "images"),
    "nerfstudio's smaller photos": ([("colmap/sparse/0", "images_2")], "images_2"),
    "instant-ngp": ([("colmap_text", "images")], "images"),
    "input beside": ([("sparse/0", "input")], "input"),
    "sparse before dense": ([("sparse/0", "images"), ("dense/0/sparse", "dense/0/images")], "images"),
}


@pytest.mark.parametrize("case", WORKSPACES)
def test_the_model_whose_photos_are_there_counts(tmp_path, case):
    """The models of a workspace differ in their focal lengths, and so do the sizes of their photos."""
    parts, expected = WORKSPACES[case]
    for number, (place, of_photos) in enumerate(parts):
        size = (32 + 4 * number, 24 + 3 * number)
        model(tmp_path, place, size=size, focal=30 + number)
        if of_photos:
            photos(tmp_path, of_photos, size)
    said = colmap.read(tmp_path)
    used = [of_photos for _, of_photos in parts].index(expected)
    assert all(view.image_path.is_relative_to(tmp_path / expected) for view in said.views) and len(said.views) == 4
    assert {view.camera.fl_x for view in said.views} == {30 + used} and not said.warnings


def test_missing_photos_are_left_out(tmp_path):
    model(tmp_path)
    photos(tmp_path)
    (tmp_path / "images/b c.png").unlink()
    (warning,) = colmap.read(tmp_path).warnings
    assert (warning.code, warning.values["names"]) == ("capture.photos_missing", ["b c.png"])


def test_photos_of_two_folders_are_not_one(tmp_path):
    """COLMAP named the photos in two folders, and people have put all of them into one."""
    model(tmp_path, lines=[line.replace("d/e.png", "left/a.png").replace("0004", "right/a.png") for line in POSES])
    photos(tmp_path)
    with pytest.raises(CaptureError, match=r"2 of 4 photos of COLMAP are missing, the first: left/a\.png"):
        colmap.read(tmp_path)


@pytest.mark.parametrize("text", [False, True], ids=["binary", "text"])
def test_rigs_and_frames_beside_the_images_change_nothing(tmp_path, text):
    """COLMAP 3.12 and later write them, too."""
    pycolmap = pytest.importorskip("pycolmap")
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig, options.num_points3D = 1, 2, 3, 20
    written = pycolmap.synthesize_dataset(options)
    (tmp_path / "sparse/0").mkdir(parents=True)
    (written.write_text if text else written.write)(str(tmp_path / "sparse/0"))
    assert any((tmp_path / "sparse/0").glob("rigs.*")) and any((tmp_path / "sparse/0").glob("frames.*"))
    read = colmap.read_cameras(tmp_path / "sparse/0")
    assert len(read) == 6
    for image in written.images.values():
        np.testing.assert_allclose(read[image.name].position, image.projection_center(), atol=1e-9)


def test_a_folder_of_projects_is_none(tmp_path):
    model(tmp_path / "vase")
    photos(tmp_path / "vase")
    assert colmap.recognizes(tmp_path / "vase") and not colmap.recognizes(tmp_path)
    shutil.rmtree(tmp_path / "vase/images")
    with pytest.raises(CaptureError, match="4 of 4 photos of COLMAP are missing"):
        load_capture(tmp_path / "vase")
