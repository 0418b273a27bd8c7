"""Photos are found under the name that a file of another program, another system or another folder gives them."""

import json
import unicodedata
from pathlib import Path

import pytest
from PIL import Image

from backend.scene_io.capture_files import read_frames, read_frames_of, with_exposures
from blender_nep.asset.cameras_file import CAMERAS, cameras_content
from blender_nep.capture import load_capture
from blender_nep.capture.formats.photo_search import IMAGES_FIRST
from blender_nep.capture.photos.photo_lookup import PhotoLookup
from blender_nep.errors import CaptureError
from support.camera_exports import known_cameras, write_bundler, write_metashape
from support.paths import ROOT


def touched(folder: Path, *names: str) -> PhotoLookup:
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()
    return PhotoLookup(folder)


def test_both_sides_have_the_same_way():
    mine, blenders = ROOT / "blender_nep/capture/photos/photo_lookup.py", ROOT / "backend/photo_lookup.py"
    assert mine.read_text(encoding="utf-8") == blenders.read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("name", "there"),
    [
        ("images/a.png", "images/a.png"),
        ("./images/a", "images/a.jpg"),
        ("images/a", "images/a.JPG"),
        ("images/a.jpg", "images/a.JPG"),
        ("images/A.PNG", "Images/a.png"),
        ("images/a.png", "images/a.jpg"),
        ("images/a.HEIC", "images/a.jpeg"),
        ("images/a.bmp", "images/a.png"),
        ("images/frame.0001", "images/frame.0001.png"),
        ("images/frame.0001.jpg", "images/frame.0001.png"),
        ("images\\a.png", "images/a.png"),
        (".\\images\\a.png", "images/a.png"),
        ("C:\\Users\\me\\vase\\images\\a.png", "images/a.png"),
        ("\\\\server\\share\\vase\\a.png", "images/a.png"),
        ("/home/me/vase/images/a.png", "images/a.png"),
        ("vase/images/a.png", "images/a.png"),
        ("../vase/images/a.png", "images/a.png"),
        ("../../data/a.png", "a.png"),
        ("a.png", "images/a.png"),
        ("images/a.png", "a.png"),
        ("images/a.png", "images_2/a.png"),
        ("images/a.png", "input/a.png"),
        ("images/left/a.png", "images/left/a.png"),
        ("images/a b (1).png", "images/a b (1).png"),
        (unicodedata.normalize("NFD", "images/Käfer.png"), unicodedata.normalize("NFC", "images/Käfer.png")),
        (unicodedata.normalize("NFC", "images/Käfer.png"), unicodedata.normalize("NFD", "images/Käfer.jpg")),
        (unicodedata.normalize("NFC", "bücher/a.png"), unicodedata.normalize("NFD", "bücher/a.png")),
    ],
)
def test_a_photo_is_found_by_a_similar_name(tmp_path, name, there):
    lookup = touched(tmp_path, there, "images/frame.0002.png", "masks/b.png")
    for found in (lookup.find(name), lookup.find(name, IMAGES_FIRST, absolute_first=False)):
        assert found is not None and found.samefile(tmp_path / there)


@pytest.mark.parametrize("name", ["images/b.png", "frame.0003", "c/frame", "", " ", "..", "/", "C:\\", "a\0.png", "x" * 300])
def test_what_is_not_there_is_not_found(tmp_path, name):
    lookup = touched(tmp_path, "images/frame.0002.png", "images/a.png", "masks/b.png", "images/b.json")
    assert lookup.find(name) is None and lookup.at(name) is None


def test_the_most_similar_name_counts(tmp_path):
    lookup = touched(tmp_path, "images/a.png", "images/A.png", "images/a.jpg", "a.png", "images_2/a.png", "b/a.png")
    assert lookup.find("images/A.png") == tmp_path / "images/A.png"
    assert lookup.find("images/a.jpg") == tmp_path / "images/a.jpg"
    assert lookup.find("images/a") == tmp_path / "images/a.png"
    assert lookup.find("D:/b/a.png") == tmp_path / "b/a.png"
    assert lookup.find("a.png") == tmp_path / "a.png" and lookup.find("a.png", IMAGES_FIRST) == tmp_path / "images/a.png"


def test_a_photo_that_cannot_be_read_counts_last(tmp_path):
    assert touched(tmp_path, "images/a.bmp").find("images/a.bmp") == tmp_path / "images/a.bmp"
    assert touched(tmp_path, "images/a.png").find("images/a.bmp") == tmp_path / "images/a.png"


def test_an_absolute_path_counts_first_or_last(tmp_path):
    touched(tmp_path / "elsewhere", "a.png")
    lookup, name = touched(tmp_path / "capture", "images/a.png"), str(tmp_path / "elsewhere/a.png")
    assert lookup.find(name) == lookup.at(name) == tmp_path / "elsewhere/a.png"
    assert lookup.find(name, absolute_first=False) == tmp_path / "capture/images/a.png"
    (tmp_path / "capture/images/a.png").unlink()
    assert lookup.find(name, absolute_first=False) == tmp_path / "elsewhere/a.png"


def test_a_mask_is_looked_for_only_where_it_is_said_to_be(tmp_path):
    """The end of the path of a mask may be the path of its photo."""
    lookup = touched(tmp_path, "a.png", "masks/B.PNG")
    assert lookup.at("masks/a.png") is None and lookup.at("masks\\b.png") == tmp_path / "masks/B.PNG"


@pytest.mark.parametrize("renamed", [lambda name: name[:-4], lambda name: f"D:\\photos\\{Path(name).name.upper()}"])
def test_both_sides_read_a_capture_with_such_names(make_capture, renamed):
    tiny = make_capture(views=4, suffix=".png")
    for frame in tiny.meta["frames"]:
        photo = tiny.folder / frame["file_path"]
        Image.open(photo).save(photo.with_suffix(".jpg"))
        photo.unlink()
        frame["file_path"] = renamed(frame["file_path"])
    tiny.save()
    capture, frames = load_capture(tiny.folder), read_frames(tiny.folder)
    assert [view.name for view in capture.views] == ["000", "001", "002", "003"] and not capture.warnings
    assert [view.image_path for view in capture.views] == [frame.path for frame in frames]


def test_names_with_points_stay_whole(make_capture):
    tiny = make_capture(views=4, suffix=".png")
    for number, frame in enumerate(tiny.meta["frames"]):
        (tiny.folder / frame["file_path"]).rename(tiny.folder / f"images/frame.{number:04d}.png")
        frame["file_path"] = f"images/frame.{number:04d}"
    tiny.save()
    assert [view.name for view in load_capture(tiny.folder).views] == [f"frame.{number:04d}" for number in range(4)]


def test_missing_photos_are_left_out_and_named(make_capture, tmp_path):
    tiny = make_capture(views=5, suffix=".png")
    for number in (1, 3):
        (tiny.folder / f"images/{number:03d}.png").unlink()
    capture = load_capture(tiny.folder)
    assert [view.name for view in capture.views] == ["000", "002", "004"]
    (warning,) = capture.warnings
    assert str(warning) == "2 of 5 photos are missing and are left out: images/001.png, images/003.png"
    asset = tmp_path / "asset"
    asset.mkdir()
    (asset / CAMERAS).write_text(json.dumps(cameras_content(capture, asset)))
    gains = [[1, 1, 1], [2, 1, 1], [3, 1, 1]]
    report = {"views": 3, "photo_gains": gains, "photos_left_out": [1]}  # one in another light, which cameras.json lacks
    (asset / "report.json").write_text(json.dumps({"capture": report}))
    frames = with_exposures(read_frames_of(tiny.folder, asset), asset)
    assert [(frame.path.stem, frame.gain[0]) for frame in frames] == [("000", 1), ("002", 2), ("004", 3)]
    (tiny.folder / "images/004.png").unlink()
    with pytest.raises(CaptureError, match=r"3 of 5 photos of transforms\.json are missing, the first: images/001\.png"):
        load_capture(tiny.folder)


@pytest.mark.parametrize("write", [write_bundler, write_metashape])
def test_other_formats_leave_out_missing_photos(tmp_path, write):
    write(tmp_path, known_cameras(centered=True))
    next(tmp_path.rglob("c.png")).unlink()
    capture = load_capture(tmp_path)
    assert [view.name for view in capture.views] == ["a", "b 2", "d"]
    assert [warning.code for warning in capture.warnings] == ["capture.photos_missing"]


def test_a_photo_does_not_stand_for_another_one(make_capture):
    """001.jpg is missing; 001.png is another photo, because the file names both. So is a photo of another folder."""
    tiny = make_capture(views=6, suffix=".png")
    tiny.meta["frames"][0]["file_path"] = "images/001.jpg"
    tiny.meta["frames"][2]["file_path"] = "other/003.png"
    tiny.save()
    capture = load_capture(tiny.folder)
    assert [view.name for view in capture.views] == ["001", "003", "004", "005"]
    assert capture.warnings[0].values["names"] == ["images/001.jpg", "other/003.png"]


def test_blenders_part_reads_what_the_engine_has_read(make_capture, tmp_path):
    """The asset's cameras.json counts, also where the capture has a transforms.json."""
    tiny = make_capture(views=4)
    asset = tmp_path / "asset"
    asset.mkdir()
    content = cameras_content(load_capture(tiny.folder), asset)
    content["frames"][0]["fl_x"] = 77.0
    (asset / CAMERAS).write_text(json.dumps(content))
    assert read_frames_of(tiny.folder, asset)[0].fl_x == 77.0


def test_two_photos_of_one_name_in_two_folders_are_not_one(make_capture):
    tiny = make_capture(views=6, suffix=".png")
    for number, name in ((0, "left/000.png"), (1, "right/000.png")):
        tiny.meta["frames"][number]["file_path"] = name
    tiny.save()
    capture = load_capture(tiny.folder)
    assert [view.name for view in capture.views] == ["002", "003", "004", "005"]
    assert capture.warnings[0].values["names"] == ["left/000.png", "right/000.png"]
