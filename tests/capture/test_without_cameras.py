"""Whoever has photos and no cameras reads what to do next, and so does who has a video, or a folder of captures."""

import shlex
from pathlib import Path

import pytest
from PIL import Image

from blender_nep.batch.captures import find_captures, passed_over
from blender_nep.cameras import found_cameras
from blender_nep.cameras.photo_folder import find_photos
from blender_nep.capture import load_capture
from blender_nep.capture.brackets import bracket_warnings
from blender_nep.errors import CaptureError, UsageError

TIME, BIAS, MODEL, DATE = 0x829A, 0x9204, 0x0110, 0x0132


def photos(folder: Path, count: int = 4, **tags: object) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for number in range(count):
        Image.new("RGB", (20, 10)).save(folder / f"{number}.jpg")
    return folder


def refused(folder: Path, ask=load_capture) -> CaptureError:
    with pytest.raises(CaptureError) as caught:
        ask(folder)
    return caught.value


@pytest.mark.parametrize("place", ["", "images"])
def test_photos_alone_lead_to_the_command_that_finds_cameras(tmp_path, place):
    folder = tmp_path / "a vase"
    photos(folder / place)
    error = refused(folder)
    assert (error.code, error.name) == (3, "capture.no_cameras") and "4 photos, but no cameras" in error.message
    assert error.hint == f"Find the cameras first: blender-nep cameras {shlex.quote(str(folder))}"
    assert len(find_photos(folder)) == 4, "the command would find them"


@pytest.mark.parametrize("place", ["rgb", "input"])
def test_photos_in_another_folder_are_named(tmp_path, place):
    photos(tmp_path / place)
    (tmp_path / "thumbnail.jpg").touch()
    assert refused(tmp_path).hint.endswith(f"blender-nep cameras {tmp_path / place}")
    error = refused(tmp_path, find_photos)
    assert error.name == "capture.photos_elsewhere" and error.hint.endswith(f"blender-nep cameras {tmp_path / place}")


@pytest.mark.parametrize("ask", [load_capture, find_photos])
def test_a_video_leads_to_the_command_that_takes_frames(tmp_path, ask):
    (tmp_path / "my clip.MP4").touch()
    error = refused(tmp_path, ask)
    assert error.name == "capture.video" and "holds a video (my clip.MP4), but no photos" in error.message
    assert error.hint.endswith(f"blender-nep cameras '{tmp_path / 'my clip.MP4'}'")
    (tmp_path / "second.mov").touch()
    assert "one of the 2 videos" in refused(tmp_path, ask).hint


def test_a_video_in_a_captures_place_leads_to_that_command(tmp_path):
    film = tmp_path / "film.mov"
    film.touch()
    error = refused(film)
    assert error.name == "capture.video" and error.hint.endswith(f"blender-nep cameras {film}")
    for named in (film, tmp_path):
        with pytest.raises(UsageError) as caught:
            find_captures([named], tmp_path / "out")
        assert caught.value.hint.endswith(f"blender-nep cameras {film}")


def test_a_folder_of_captures_leads_to_the_batch(tmp_path, make_capture):
    make_capture(name="shelf/vase", size=8)
    photos(tmp_path / "shelf/phone")
    (tmp_path / "shelf/notes").mkdir()
    error = refused(tmp_path / "shelf")
    assert "(phone, vase)" in error.message and f"blender-nep batch {tmp_path / 'shelf'}" in error.hint


def test_other_folders_are_told_what_a_capture_is(tmp_path):
    (tmp_path / "notes.txt").touch()
    error = refused(tmp_path)
    assert "has no transforms.json" in error.message and "COLMAP" in error.hint
    (tmp_path / "notes.txt").unlink()
    assert "is empty" in refused(tmp_path).message


def test_a_batch_says_what_it_passes_over(tmp_path):
    for name in ("vase", "app/rgb", "images"):
        photos(tmp_path / name)
    (tmp_path / "notes").mkdir()
    found = find_captures([tmp_path], tmp_path / "out")
    assert [one.path.name for one in found] == [tmp_path.name], "it holds photos in images/"
    (beside,) = passed_over([tmp_path], tmp_path / "out", found)
    assert beside.code == "batch.captures_beside_photos" and beside.values["names"] == [str(tmp_path / "vase")]
    (tmp_path / "images").rename(tmp_path / ".images")
    found = find_captures([tmp_path], tmp_path / "out")
    over, deeper = passed_over([tmp_path], tmp_path / "out", found)
    assert [one.path.name for one in found] == ["vase"] and over.values["names"] == ["app", "notes"]
    assert deeper.values["names"] == [str(tmp_path / "app/rgb")]
    assert deeper.values["command"] == f"blender-nep cameras {tmp_path / 'app/rgb'}"
    assert not passed_over([tmp_path / "vase"], tmp_path / "out", found)


def test_a_batch_without_captures_names_the_photos(tmp_path):
    photos(tmp_path / "app/rgb")
    with pytest.raises(UsageError) as caught:
        find_captures([tmp_path], tmp_path / "out")
    assert caught.value.hint.endswith(f"blender-nep cameras {tmp_path / 'app/rgb'}")


def with_exif(folder: Path, tags: list[dict]) -> list[Path]:
    folder.mkdir(exist_ok=True)
    for number, entry in enumerate(tags):
        exif = Image.Exif()
        for tag, value in entry.items():
            if tag == TIME:
                exif.get_ifd(0x8769)[tag] = value
            else:
                exif[tag] = value
        Image.new("RGB", (20, 10)).save(folder / f"{number:02d}.jpg", exif=exif)
    return sorted(folder.iterdir())


@pytest.mark.parametrize(
    ("tags", "said"),
    [
        ({}, "These photos have no EXIF."),
        ({DATE: "2026:01:01 00:00:00"}, "EXIF of these photos does not tell the focal length."),
        ({MODEL: "a camera"}, ""),
    ],
)
def test_no_exif_is_said_only_where_there_is_none(tmp_path, tags, said):
    with_exif(tmp_path / "photos", [tags] * 4)
    with pytest.raises(CaptureError) as caught:
        found_cameras.choose(find_photos(tmp_path / "photos"), [])
    assert (said in caught.value.hint) and ("EXIF" in caught.value.hint) == bool(said)


@pytest.mark.parametrize(
    ("times", "size"), [((0.01, 0.0025, 0.04), 3), ((0.001, 0.004, 0.016, 0.064, 0.256), 5), ((1, 4), 2)]
)
def test_brackets_are_a_warning(tmp_path, times, size):
    tags = [{TIME: time * (1 + 0.02 * view)} for view in range(4) for time in times]
    (warning,) = bracket_warnings(with_exif(tmp_path / "photos", tags))
    assert warning.code == "capture.brackets" and warning.values["size"] == size and warning.values["photos"] == 4 * size


@pytest.mark.parametrize(
    "times",
    [
        [0.01] * 12,
        [0.01, 0.02, 0.011, 0.04, 0.09, 0.01, 0.013, 0.02, 0.05, 0.04, 0.01, 0.02],
        [0.01 * 1.1**k for k in range(12)],
        [None] * 12,
    ],
)
def test_other_exposures_are_no_brackets(tmp_path, times):
    tags = [{} if time is None else {TIME: time} for time in times]
    assert not bracket_warnings(with_exif(tmp_path / "photos", tags))
