"""Masks that no file names are found, and are never taken for photos."""

from __future__ import annotations

import json

import numpy as np
import pytest
from PIL import Image

from backend.engine.results.capture_contents import has_masks, photo_count
from blender_nep.cameras.photo_folder import find_photos
from blender_nep.capture.formats.mask_search import find_masks, masks_beside
from blender_nep.capture.formats.photo_search import photos_in
from blender_nep.capture.loading import load_capture
from blender_nep.errors import CaptureError
from support.captures import TinyCapture

SIZE = 24


def ball(size: int = SIZE, width: int = 0) -> Image.Image:
    """`width`: of a mask that is no square; else `size`"""
    row, column = np.mgrid[:size, : width or size] + 0.5
    return Image.fromarray(np.uint8(255) * (np.hypot(row - size / 2, column - size / 2) < size / 4))


@pytest.fixture
def tiny(make_capture) -> TinyCapture:
    """Photos in `images/`, whose mask no file names."""
    capture = make_capture(views=4, size=SIZE, suffix=".jpg")
    (capture.folder / "masks").rmdir()
    return capture


def put(tiny: TinyCapture, form: str, size: int = SIZE, numbers: range = range(4)) -> None:
    for number in numbers:
        path = tiny.folder / form.format(number)
        path.parent.mkdir(parents=True, exist_ok=True)
        ball(size).save(path)


def codes(capture) -> list[str]:
    return [warning.code for warning in capture.warnings]


FORMS = {
    "masks": "masks/{:03d}.png",
    "masks jpg": "masks/{:03d}.jpg",
    "masks of colmap": "masks/{:03d}.jpg.png",
    "masks in capitals": "Masks/{:03d}.JPG",
    "mask": "mask/{:03d}.png",
    "masks with the word": "masks/{:03d}_mask.tif",
    "masks with both": "masks/{:03d}.jpg.mask.png",
    "masks of a folder": "images_masks/{:03d}.png",
    "masks to train": "train_mask/{:03d}.png",
    "masks with folders": "masks/images/{:03d}.png",
    "masks among photos": "images/masks/{:03d}.png",
    "beside": "images/{:03d}_mask.png",
    "beside jpg": "images/{:03d}-MASK.jpg",
    "beside with both": "images/{:03d}.jpg.mask.png",
}


@pytest.mark.parametrize("form", FORMS.values(), ids=FORMS.keys())
def test_masks_that_no_file_names_are_found(tiny, form):
    before = load_capture(tiny.folder)
    put(tiny, form)
    capture = load_capture(tiny.folder)
    assert [view.mask_path for view in capture.views] == [tiny.folder / form.format(number) for number in range(4)]
    (news,) = (warning for warning in capture.warnings if "masks" in warning.code)
    assert news.values["count"] == news.values["photos"] == 4
    assert news.values.get("place", "images") == form.rpartition("/")[0].removesuffix("/images")
    assert not before.views[0].mask_path and not codes(load_capture(tiny.folder, use_masks=False))


def test_named_masks_win_and_are_no_news(tiny):
    put(tiny, "masks/{:03d}.png")
    put(tiny, "drawn/{:03d}.png")
    for number, frame in enumerate(tiny.meta["frames"]):
        frame["mask_path"] = f"drawn/{number:03d}.png"
    capture = load_capture(tiny.save())
    assert {view.mask_path.parent.name for view in capture.views} == {"drawn"} and not codes(capture)


def test_masks_of_another_aspect_are_told_and_not_used(tiny):
    put(tiny, "masks/{:03d}.png")
    ball(SIZE, width=SIZE // 2).save(tiny.folder / "masks/002.png")
    capture = load_capture(tiny.folder)
    assert [view.mask_path is None for view in capture.views] == [False, False, True, False]
    assert codes(capture) == ["capture.masks_found", "capture.masks_other_size"]
    assert capture.warnings[1].values == {"count": 1, "names": ["002"]}


def test_one_mask_for_all_photos_is_found(tiny):
    for place in ("mask.png", "masks/camera_mask.png"):
        put(tiny, place, numbers=range(1))
        capture = load_capture(tiny.folder)
        assert {view.mask_path for view in capture.views} == {tiny.folder / place}
        assert "capture.masks_one_for_all" in codes(capture)


@pytest.mark.parametrize("mark", ["report.json", "checkpoints/run.json"])
def test_masks_in_an_asset_do_not_count(tiny, mark):
    put(tiny, "mask/{:03d}.png")
    (tiny.folder / "mask/checkpoints").mkdir()
    (tiny.folder / "mask" / mark).touch()
    assert not any(view.mask_path for view in load_capture(tiny.folder).views)


def test_masks_of_other_photos_do_not_count(tiny):
    """`masks/` is of the photos to learn from, `test_masks/` of those to test with. Both have the same names."""
    put(tiny, "masks/{:03d}.png")
    put(tiny, "test_masks/{:03d}.png", numbers=range(3))
    (tiny.folder / "images").rename(tiny.folder / "test")
    photos = sorted((tiny.folder / "test").iterdir())
    found = find_masks(tiny.folder, photos).masks
    assert [path and path.parent.name for path in found] == ["test_masks", "test_masks", "test_masks", None]


def test_a_name_that_two_photos_have_is_not_enough(tiny):
    put(tiny, "masks/{:03d}.png")
    photos = [tiny.folder / f"{side}/{number:03d}.jpg" for side in ("left", "right") for number in range(4)]
    assert not any(find_masks(tiny.folder, photos).masks)
    put(tiny, "masks/right/{:03d}.png")
    found = find_masks(tiny.folder, photos).masks
    assert found[:4] == [None] * 4 and found[4] == tiny.folder / "masks/right/000.png"


def test_masks_beside_photos_are_no_photos(tiny):
    photos = tiny.folder / "images"
    assert not has_masks(tiny.folder)
    put(tiny, "images/{:03d}.jpg.mask.png", numbers=range(2))
    put(tiny, "images/{:03d}_mask.jpg", numbers=range(2, 4))
    expected = [photos / f"{number:03d}.jpg" for number in range(4)]
    assert photos_in(photos) == expected and photo_count(photos) == 4 and has_masks(photos) and has_masks(tiny.folder)
    found = find_photos(photos)
    assert [photo.path for photo in found] == expected and [photo.mask.suffix for photo in found] == [".png"] * 2 + [
        ".jpg"
    ] * 2
    assert load_capture(tiny.folder).views[0].mask_path.name == "000.jpg.mask.png"


def test_a_photo_of_a_mask_is_a_photo(tmp_path):
    """Its name is that of no other photo."""
    names = ["carnival_mask.jpg", "mask.jpg", "mask_2.jpg"]
    assert not masks_beside([tmp_path / name for name in names])
    assert masks_beside([tmp_path / "Carnival.NEF", tmp_path / "carnival_MASK.jpg"]) == {tmp_path / "carnival_MASK.jpg"}


@pytest.mark.parametrize("place", ["masks/a.png", "mask/a.JPG", "train_mask/a.png"])
def test_the_panel_knows_folders_of_masks(tmp_path, place):
    (tmp_path / place).parent.mkdir()
    assert not has_masks(tmp_path)
    (tmp_path / place).touch()
    assert has_masks(tmp_path) and not has_masks(tmp_path / "none")
    (tmp_path / "train").mkdir()
    (tmp_path / place).parent.rename(tmp_path / "test_masks")
    assert not has_masks(tmp_path)


def test_a_mask_of_a_moved_capture_is_found(tiny):
    put(tiny, "masks/{:03d}.png")
    file = tiny.folder / "transforms.json"
    content = json.loads(file.read_text())
    for number, frame in enumerate(content["frames"]):
        frame["mask_path"] = f"C:\\cap\\masks\\{number:03d}.png" if number % 2 else f"/home/alice/cap/masks/{number:03d}.png"
    file.write_text(json.dumps(content))
    masks = [view.mask_path for view in load_capture(tiny.folder).views]
    assert masks == [tiny.folder / f"masks/{number:03d}.png" for number in range(4)]


def test_masks_that_are_not_wanted_stop_no_search_for_cameras(tiny):
    (tiny.folder / "masks").mkdir()
    ball(SIZE, width=SIZE // 2).save(tiny.folder / "masks/000.png")
    (tiny.folder / "masks/001.png").write_bytes(b"no mask")
    put(tiny, "masks/{:03d}.png", numbers=range(2, 4))
    masks = [photo.mask for photo in find_photos(tiny.folder)]
    assert masks[:2] == [None, None] and all(masks[2:])
    with pytest.raises(CaptureError, match="000"):
        find_photos(tiny.folder, masked=True)
