"""Captures as people hand them in: what is there twice, under another name, in another place, or without a pose."""

from __future__ import annotations

import json
import shutil
import struct
import unicodedata
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from backend.engine.results.capture_contents import photo_count
from backend.scene_io.capture_files import read_frames
from blender_nep import cli
from blender_nep.cameras.photo_folder import find_photos
from blender_nep.capture import load_capture
from blender_nep.capture.bounds import sphere_from_cameras
from blender_nep.capture.formats import colmap, metashape
from blender_nep.errors import CaptureError
from support.camera_exports import known_cameras, write_metashape
from support.captures import TinyCapture

VIEWS = 8


@pytest.fixture
def tiny(make_capture) -> TinyCapture:
    """Photos and transforms.json, without a sphere."""
    return make_capture(views=VIEWS, size=20, suffix=".png", bounds=False)


def refused(folder: Path, ask=load_capture) -> CaptureError:
    with pytest.raises(CaptureError) as caught:
        ask(folder)
    return caught.value


def only_code(capture) -> tuple[str, list[str]]:
    (message,) = capture.warnings
    return message.code, message.values["names"]


# what transforms.json says


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le", "utf-32"])
def test_json_of_any_unicode_is_read(tiny, encoding):
    (tiny.folder / "transforms.json").write_bytes(json.dumps(tiny.meta).encode(encoding))
    assert len(load_capture(tiny.folder).views) == VIEWS


@pytest.mark.parametrize("change", [lambda text: text[:-1] + ",}", lambda text: "// a\n" + text, lambda text: text[:300]])
def test_text_that_is_nearly_json_is_told(tiny, change):
    path = tiny.folder / "transforms.json"
    path.write_text(change(path.read_text()))
    assert "no comments" in refused(tiny.folder).hint


BLANK = {
    "null": None,
    "zeros": np.zeros((4, 4)).tolist(),
    "NaN": np.full((4, 4), np.nan).tolist(),
    "infinite": np.full((3, 4), -np.inf).tolist(),
}


@pytest.mark.parametrize("case", BLANK)
def test_a_photo_without_a_pose_is_left_out(tiny, case):
    tiny.meta["frames"][2]["transform_matrix"] = BLANK[case]
    capture = load_capture(tiny.save())
    assert only_code(capture) == ("capture.photos_without_pose", ["images/002.png"])
    assert [frame.path for frame in read_frames(tiny.folder)] == [view.image_path for view in capture.views], "in Blender"
    for frame in tiny.meta["frames"][2:]:
        frame["transform_matrix"] = BLANK[case]
    assert "images/00" in refused(tiny.save()).message


def test_a_camera_where_the_object_is_is_left_out(tiny):
    """Programs write an identity matrix for a photo that they have not placed."""
    others = [view.camera for view in load_capture(tiny.folder).views if view.name != "002"]
    center, radius = sphere_from_cameras(others)
    matrix = np.eye(4)
    matrix[:3, 3] = center + 0.02
    tiny.meta["frames"][2]["transform_matrix"] = matrix.tolist()
    capture = load_capture(tiny.save())
    assert only_code(capture) == ("capture.cameras_in_object", ["002"])
    np.testing.assert_allclose([*capture.object_center, capture.object_radius], [*center, radius])


def test_a_photo_that_is_listed_twice_counts_once(tiny):
    tiny.meta["frames"].append(tiny.meta["frames"][1])
    capture = load_capture(tiny.save())
    assert only_code(capture) == ("capture.frames_twice", ["images/001.png"]) and len(capture.views) == VIEWS
    tiny.meta["frames"][-1] = dict(tiny.meta["frames"][2], file_path="./images/001.png")
    assert "several cameras for 001.png" in refused(tiny.save()).message


def test_intrinsics_as_parts_of_the_size_are_told(tiny):
    tiny.meta |= {"fl_x": 1.2, "fl_y": 1.2, "cx": 0.5, "cy": 0.5}
    assert "Multiply fl_x and cx by the width" in refused(tiny.save()).hint


def test_an_angle_in_degrees_is_told(tiny):
    for key in ("fl_x", "fl_y"):
        del tiny.meta[key]
    tiny.meta["camera_angle_x"] = 45
    assert refused(tiny.save()).hint == "It is in radians; x_fov is in degrees."


def test_names_of_addresses_are_found(tiny):
    for frame in tiny.meta["frames"]:
        photo = tiny.folder / frame["file_path"]
        photo.rename(photo.with_name(f"my vase {photo.name}"))
        frame["file_path"] = f"images/my%20vase%20{photo.name}"
    assert len(load_capture(tiny.save()).views) == VIEWS


def test_spaces_around_names_and_capitals_of_keys_do_not_matter(tiny):
    for frame in tiny.meta["frames"]:
        frame["file_path"] = f" {frame['file_path']} "
    tiny.meta["color_space"] = "Linear"
    assert load_capture(tiny.save()).color_space == "linear"


def test_names_of_either_unicode_form_are_found(tiny):
    for frame in tiny.meta["frames"]:
        photo = tiny.folder / frame["file_path"]
        name = f"Gef\u00e4\u00df {photo.name}"
        photo.rename(photo.with_name(unicodedata.normalize("NFD", name)))
        frame["file_path"] = name
    assert len(load_capture(tiny.save()).views) == VIEWS


def test_photos_only_in_a_smaller_size_are_used(tiny):
    (tiny.folder / "images").rename(tiny.folder / "images_4")
    for path in (tiny.folder / "images_4").iterdir():
        Image.open(path).resize((5, 5)).save(path)
    capture = load_capture(tiny.folder)
    assert only_code(capture)[0] == "capture.photos_rescaled" and capture.views[0].camera.fl_x == pytest.approx(6)


# names and places


@pytest.mark.parametrize("name", ["Transforms.JSON", "transforms (1).json", "transforms.json.txt", "transforms_val.json"])
def test_cameras_under_another_name_are_told(tiny, name):
    (tiny.folder / "transforms.json").rename(tiny.folder / name)
    if (tiny.folder / "transforms.json").exists():
        pytest.skip("the file system takes both names for one")
    error = refused(tiny.folder)
    assert name in error.message and "rename it to transforms.json" in error.hint


@pytest.mark.parametrize("part", ["images", "masks", "transforms.json"])
def test_a_part_of_a_capture_leads_to_the_whole(tiny, part):
    (tiny.folder / "masks/000.png").touch()
    assert str(tiny.folder) in refused(tiny.folder / part).hint.split(": ")[-1]


def test_photos_beside_a_capture_are_no_part_of_it(tiny):
    shutil.copytree(tiny.folder / "images", tiny.folder / "vase")
    assert refused(tiny.folder / "vase").name == "capture.no_cameras"


@pytest.mark.parametrize("second", ["CR2", "JPG", "tif"])
def test_a_photo_that_is_there_twice_counts_once(tmp_path, second):
    for i in range(4):
        Image.new("RGB", (8, 8)).save(tmp_path / f"{i}.jpg")
        (tmp_path / f"{i}.{second}").touch()
    if len(list(tmp_path.iterdir())) < 8:
        pytest.skip("the file system takes both names for one")
    assert "holds 4 photos, but no cameras" in refused(tmp_path).message
    assert photo_count(tmp_path) == 4
    for i in range(4):
        shutil.copy(tmp_path / f"{i}.jpg", tmp_path / f"{i}.JPG") if second == "JPG" else None
    assert len(find_photos(tmp_path)) == 4


def test_archives_are_to_be_unpacked(tmp_path):
    (tmp_path / "vase.zip").touch()
    assert "Unpack it" in refused(tmp_path).hint and "Unpack it" in refused(tmp_path / "vase.zip").hint


def test_an_asset_is_no_capture(tiny):
    for name in ("report.json", "mesh.obj"):
        (tiny.folder / name).touch()
    (tiny.folder / "transforms.json").rename(tiny.folder / "cameras.json")
    assert "is an asset" in refused(tiny.folder).message


@pytest.mark.parametrize("ending", ["gif", "bmp", "avif"])
def test_photos_of_kinds_that_are_not_read_are_named(tmp_path, ending):
    for i in range(4):
        (tmp_path / f"{i}.{ending}").touch()
    for error in (refused(tmp_path), refused(tmp_path, find_photos)):
        assert error.name == "capture.photos_of_other_kinds" and error.values["kinds"] == [ending]


@pytest.mark.parametrize(
    ("content", "said"), [(b"", "it is empty"), (b"version https://git-lfs.github.com/spec/v1\n", "pointer of Git LFS")]
)
def test_photos_without_content_say_why(tiny, content, said):
    (tiny.folder / "images/003.png").write_bytes(content)
    tiny.meta.pop("w")
    tiny.meta.pop("h")
    error = refused(tiny.save())
    assert "003.png" in error.message and said in error.message


def test_cameras_in_a_folder_beside_the_photos_are_told(tmp_path):
    write_metashape(tmp_path, known_cameras(centered=True))
    (tmp_path / "export").mkdir()
    (tmp_path / "cameras.xml").rename(tmp_path / "export/cameras.xml")
    error = refused(tmp_path)
    assert "its cameras are in export" in error.message and "Move the files" in error.hint


def test_info_says_whose_cameras_are_read(tiny, capsys):
    assert cli.main(["info", str(tiny.folder)]) == 0
    assert "cameras of transforms.json" in capsys.readouterr().out


@pytest.mark.parametrize("spoil", [lambda path: path.write_text("{"), lambda path: path.write_text('{"frames": []}')])
def test_other_cameras_are_named_where_the_first_are_wrong(tiny, spoil):
    write_colmap(tiny)
    spoil(tiny.folder / "transforms.json")
    assert "also holds cameras of another form" in refused(tiny.folder).hint


# COLMAP and Metashape


def write_colmap(tiny: TinyCapture, ending: str = "txt", count: int = VIEWS, focal: float = 24.0, lost=None) -> Path:
    """A model of the first `count` photos. lost: the numbers that photo 1 has instead of its pose."""
    folder = tiny.folder / "sparse/0"
    folder.mkdir(parents=True, exist_ok=True)
    poses = [[0.5, 0.5, 0.5, -0.5, 0.1 * i, -0.2, 3.0 + i] for i in range(count)]
    if lost is not None:
        poses[1] = lost
    if ending == "txt":
        (folder / "cameras.txt").write_text(f"1 PINHOLE 20 20 {focal} {focal} 10 10\n")
        lines = [f"{i + 1} {' '.join(map(str, pose))} 1 {i:03d}.png\n\n" for i, pose in enumerate(poses)]
        (folder / "images.txt").write_text("".join(lines))
        return tiny.folder
    (folder / "cameras.bin").write_bytes(struct.pack("<QiiQQ4d", 1, 1, 1, 20, 20, focal, focal, 10, 10))
    entries = [
        struct.pack("<i7di", i + 1, *pose, 1) + f"{i:03d}.png\0".encode() + struct.pack("<Q", 0)
        for i, pose in enumerate(poses)
    ]
    (folder / "images.bin").write_bytes(struct.pack("<Q", count) + b"".join(entries))
    return tiny.folder


@pytest.mark.parametrize(
    ("bin_", "txt", "used", "codes"),
    [
        ({}, {}, "bin", []),
        ({"focal": 30.0}, {}, "bin", ["capture.two_forms"]),
        ({"count": 4}, {}, "txt", ["capture.two_forms"]),
        ({"count": 0}, {}, "txt", []),
        ({}, {"count": 5}, "bin", ["capture.two_forms"]),
    ],
    ids=["equal", "another lens", "fewer photos", "empty", "fewer photos as text"],
)
def test_the_fuller_of_two_forms_of_a_model_counts(tiny, bin_, txt, used, codes):
    write_colmap(tiny, "bin", **bin_)
    said = colmap.read(write_colmap(tiny, "txt", **txt))
    assert {path.suffix for path in said.files} == {f".{used}"} and [one.code for one in said.warnings] == codes


@pytest.mark.parametrize("ending", ["bin", "txt"])
@pytest.mark.parametrize("lost", [[0, 0, 0, 0, 1, 2, 3], [float("nan")] * 7, [1, 0, 0, 0, 1, float("inf"), 3]])
def test_a_photo_that_colmap_has_lost_is_left_out(tiny, ending, lost):
    said = colmap.read(write_colmap(tiny, ending, lost=lost))
    assert only_code(said) == ("capture.photos_without_pose", ["001.png"]) and len(said.views) == VIEWS - 1


def test_a_model_in_a_part_of_a_capture_leads_to_the_whole(tiny):
    (tiny.folder / "transforms.json").unlink()
    write_colmap(tiny)
    assert refused(tiny.folder / "sparse/0").hint == f"Name the whole capture: {tiny.folder}"


def test_a_model_without_its_lenses_is_told(tiny):
    (tiny.folder / "transforms.json").unlink()
    write_colmap(tiny)
    (tiny.folder / "sparse/0/cameras.txt").unlink()
    assert "belong together" in refused(tiny.folder).hint


def test_a_photo_that_metashape_has_lost_is_left_out(tmp_path):
    write_metashape(tmp_path, known_cameras(centered=True))
    path = tmp_path / "cameras.xml"
    start, _, end = path.read_text().partition('label="b 2.png"><transform>')
    path.write_text(f'{start}label="b 2.png"><transform>nan {end.partition(" ")[2]}')
    assert only_code(metashape.read(tmp_path)) == ("capture.photos_without_pose", ["b 2.png"])
