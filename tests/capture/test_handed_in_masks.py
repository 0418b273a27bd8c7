"""Masks as people hand them in: colored, of another size, some inverted, for most photos, in the photos' alpha."""

from __future__ import annotations

import shutil
import unicodedata

import numpy as np
import pytest
from PIL import Image, ImageFilter

from backend.engine.results.capture_contents import has_masks
from blender_nep.capture.loading import load_capture
from blender_nep.capture.photos.mask_files import MaskMeaning
from blender_nep.capture.rays.pixel_rays import PixelRays
from blender_nep.errors import CaptureError
from support.captures import CENTER, TinyCapture

VIEWS, SIZE = 6, 40


@pytest.fixture
def ball(make_capture) -> TinyCapture:
    """Photos of a ball, with its masks in `masks/`, and without a sphere."""
    tiny = make_capture(views=VIEWS, size=SIZE, suffix=".png", masks=True, bounds=False)
    for frame in tiny.meta["frames"]:
        del frame["mask_path"]
    tiny.save()
    return tiny


def truth(tiny: TinyCapture) -> list[np.ndarray]:
    return [np.asarray(Image.open(tiny.folder / f"masks/{i:03d}.png")) > 127 for i in range(VIEWS)]


def codes(messages) -> list[str]:
    return [message.code for message in messages]


def loaded(tiny: TinyCapture) -> tuple[list[np.ndarray], list[str]]:
    """The masks as a job sees them, and the codes of what is said, but for where the masks were found."""
    capture = load_capture(tiny.folder)
    masks = [capture.load_mask(i) for i in range(len(capture.views))]
    return [mask > 0.5 for mask in masks], [code for code in codes(capture.warnings) if code != "capture.masks_found"]


def painted(mask: np.ndarray, of_object, of_rest) -> np.ndarray:
    return np.where(mask[..., None], of_object, of_rest).astype(np.uint8)


def with_a_person(mask: np.ndarray) -> np.ndarray:
    picture = painted(mask, (0, 128, 0), (0, 0, 0))
    picture[:10, :8] = (128, 0, 0)
    return picture


def cut_out(mask: np.ndarray) -> np.ndarray:
    """A picture of the ball in many colors before black, with a black spot on it."""
    row, column = np.mgrid[:SIZE, :SIZE]
    picture = np.stack([60 + 4 * row, 250 - 5 * column, 80 + 2 * (row + column)], -1)
    picture[SIZE // 2, SIZE // 2] = 0
    return np.where(mask[..., None], picture, 0).astype(np.uint8)


def numbers(mask: np.ndarray) -> np.ndarray:
    picture = np.where(mask, 5, 0).astype(np.uint8)
    picture[:10, :8] = 9
    return picture


COLORED = {
    "green on black": (lambda mask: painted(mask, (0, 255, 0), (0, 0, 0)), "capture.masks_labels"),
    "green on purple": (lambda mask: painted(mask, (0, 200, 0), (120, 0, 120)), "capture.masks_labels"),
    "black on blue": (lambda mask: painted(mask, (0, 0, 0), (0, 0, 255)), "capture.masks_labels"),
    "three colors": (with_a_person, "capture.masks_labels"),
    "numbers of things": (numbers, "capture.masks_labels"),
    "cut out before black": (cut_out, "capture.masks_pictures"),
}


@pytest.mark.parametrize("case", COLORED)
def test_the_object_of_colored_masks_is_found(ball, case):
    paint, code = COLORED[case]
    expected = truth(ball)
    for i, mask in enumerate(expected):
        Image.fromarray(paint(mask)).save(ball.folder / f"masks/{i:03d}.png")
    masks, said = loaded(ball)
    assert said == [code] and all((a == b).all() for a, b in zip(masks, expected, strict=True))


def test_colors_that_say_nothing_are_told(ball):
    noise = np.random.default_rng(3)
    for i in range(VIEWS):
        Image.fromarray(noise.integers(0, 255, (SIZE, SIZE, 3), np.uint8)).save(ball.folder / f"masks/{i:03d}.png")
    assert "capture.masks_colors_unclear" in loaded(ball)[1]


def test_soft_gray_masks_have_no_color(ball):
    for i, mask in enumerate(truth(ball)):
        soft = Image.fromarray(np.uint8(255) * mask).filter(ImageFilter.GaussianBlur(1.5)).convert("RGB")
        soft.save(ball.folder / f"masks/{i:03d}.png")
    assert loaded(ball)[1] == []


@pytest.mark.parametrize("usual", [False, True], ids=["white is the object", "white is the rest"])
def test_a_few_masks_of_the_other_kind_are_turned(ball, usual):
    expected = truth(ball)
    for i, mask in enumerate(expected):
        Image.fromarray(np.uint8(255) * (mask != (usual != (i in (1, 4))))).save(ball.folder / f"masks/{i:03d}.png")
    masks, said = loaded(ball)
    alike = ["capture.masks_alike"]  # the ball is in the middle of all photos
    assert said == ["capture.masks_background", *alike] * usual + ["capture.masks_turned"]
    assert all((a == b).all() for a, b in zip(masks, expected, strict=True))


@pytest.mark.parametrize("factor", [2, 1.25])
@pytest.mark.parametrize("larger", [False, True], ids=["smaller", "larger"])
def test_masks_of_another_size_are_scaled(ball, factor, larger):
    expected = truth(ball)
    for i, mask in enumerate(expected):
        size = int(SIZE * factor if larger else SIZE / factor)
        Image.fromarray(mask).resize((size, size)).save(ball.folder / f"masks/{i:03d}.png")
    masks, said = loaded(ball)
    assert said == ["capture.masks_rescaled"]
    assert all((a != b).mean() < 0.02 * factor for a, b in zip(masks, expected, strict=True))


def test_rows_of_a_scaled_mask_are_those_of_the_whole(ball):
    for i in range(VIEWS):
        path = ball.folder / f"masks/{i:03d}.png"
        Image.open(path).resize((SIZE // 3, SIZE // 3)).save(path)
    mask = load_capture(ball.folder).open_mask(0)
    parts = [mask.rows(start, start + 7) for start in range(0, SIZE, 7)]
    assert mask.size == (SIZE, SIZE) and (np.concatenate(parts) == mask.rows()).all()
    assert mask.coverage(4).shape == (SIZE // 4, SIZE // 4) and mask.rows(SIZE, SIZE + 7).shape == (0, SIZE)


def test_a_photo_without_a_mask_is_left_out(ball):
    """If more than a fifth lacks one, no masks are used."""
    (ball.folder / "masks/002.png").unlink()
    capture = load_capture(ball.folder)
    rays = PixelRays.from_capture(capture, 10_000, True)
    (news,) = (message for message in rays.warnings if "masks" in message.code)
    assert news.code == "capture.masks_lacking" and news.values["names"] == ["002"] and capture.bounds_source == "masks"
    used = [int(rays.valid[a:b].sum()) for a, b in zip(rays.offset, rays.offset[1:], strict=False)]
    assert [count > 0 for count in used] == [True, True, False, True, True, True]
    (ball.folder / "masks/003.png").unlink()
    rays = PixelRays.from_capture(load_capture(ball.folder), 10_000, True)
    assert rays.mask is None and "capture.masks_missing" in codes(rays.warnings)


@pytest.mark.parametrize(
    "form",
    ["alpha/{:03d}.png", "segmentation/{:03d}.png", "silhouettes/{:03d}.png", "mattes/{:03d}_matte.png", "{:03d}_alpha.png"],
)
def test_other_words_for_masks_are_known(ball, form):
    if "/" not in form:
        form = f"images/{form}"
    for i in range(VIEWS):
        path = ball.folder / form.format(i)
        path.parent.mkdir(exist_ok=True)
        shutil.move(ball.folder / f"masks/{i:03d}.png", path)
    (ball.folder / "masks").rmdir()
    capture = load_capture(ball.folder)
    assert [view.mask_path for view in capture.views] == [ball.folder / form.format(i) for i in range(VIEWS)]
    assert has_masks(ball.folder) and len(codes(capture.warnings)) == 1


def test_masks_are_found_by_names_of_either_unicode_form(ball):
    for i, frame in enumerate(ball.meta["frames"]):
        name = f"Vas\u00e9_{i}"
        (ball.folder / frame["file_path"]).rename(ball.folder / f"images/{unicodedata.normalize('NFD', name)}.png")
        (ball.folder / f"masks/{i:03d}.png").rename(ball.folder / f"masks/{name}.png")
        frame["file_path"] = f"images/{name}.png"
    assert all(view.mask_path for view in load_capture(ball.save()).views)


def test_masks_of_kinds_that_are_not_read_are_told(ball):
    for i in range(VIEWS):
        path = ball.folder / f"masks/{i:03d}.png"
        Image.open(path).save(path.with_suffix(".gif"))
        path.unlink()
    (warning,) = load_capture(ball.folder).warnings
    assert warning.code == "capture.masks_other_kind" and warning.values == {"place": "masks", "kinds": ["gif"]}


def test_folders_in_a_folder_of_masks_are_seen_by_the_panel(ball):
    (ball.folder / "masks").rename(ball.folder / "inner")
    (ball.folder / "masks/left/day").mkdir(parents=True)
    assert not has_masks(ball.folder)
    (ball.folder / "inner").rename(ball.folder / "masks/left/day/2")
    assert has_masks(ball.folder)


@pytest.mark.parametrize("kept", [True, False], ids=["colors kept", "colors lost"])
def test_inverted_alpha_is_the_mask(ball, kept):
    """The photos are transparent where the object is. They are whole photos then, if their colors are there."""
    expected = truth(ball)
    shutil.rmtree(ball.folder / "masks")
    for i, mask in enumerate(expected):
        path = ball.folder / f"images/{i:03d}.png"
        photo = np.asarray(Image.open(path).convert("RGB")).copy()
        photo[SIZE // 2, SIZE // 2 - 3 : SIZE // 2 + 3] = 200, 100, 50
        photo[mask & (not kept)] = 0
        Image.fromarray(np.dstack([photo, np.uint8(255) * ~mask])).save(path)
    if not kept:
        with pytest.raises(CaptureError, match="their alpha is inverted"):
            load_capture(ball.folder)
        return
    capture = load_capture(ball.folder)
    masks = [capture.load_mask(i) for i in range(VIEWS)]
    assert codes(capture.warnings) == ["capture.alpha_inverted"] and not capture.open_photo(0).has_alpha
    assert all(((a > 0.5) == b).all() for a, b in zip(masks, expected, strict=True))
    assert (
        capture.mask_reading.meaning == MaskMeaning.BACKGROUND and PixelRays.from_capture(capture, 10_000, True).background
    )


def silhouettes(tiny: TinyCapture) -> list[np.ndarray]:
    """Of two balls of different size, beside each other, which look different in each photo."""
    rows, columns = np.mgrid[:SIZE, :SIZE] + 0.5
    found = []
    for view in load_capture(tiny.folder, use_masks=False).views:
        direction = view.camera.directions(columns.ravel(), rows.ravel())
        shown = np.zeros(SIZE * SIZE, bool)
        for center, radius in ((CENTER - [-0.45, 0.0, 0.0], 0.3), (CENTER - [0.3, 0.3, 0.2], 0.12)):
            to_center = center - view.camera.position
            shown |= np.linalg.norm(to_center - (direction @ to_center)[:, None] * direction, axis=1) < radius
        found.append(shown.reshape(SIZE, SIZE))
    return found


@pytest.mark.parametrize(("shift", "code"), [(0, []), (1, ["capture.masks_do_not_fit"])], ids=["right", "of other photos"])
def test_masks_of_other_photos_are_not_used(make_capture, shift, code):
    tiny = make_capture(views=10, size=SIZE, suffix=".png", bounds=False)
    masks = silhouettes(tiny)
    for i in range(10):
        Image.fromarray(np.uint8(255) * masks[(i + shift) % 10]).save(tiny.folder / f"masks/{i:03d}.png")
    capture = load_capture(tiny.folder)
    said = [one for one in codes(capture.warnings) if one not in ("capture.masks_found", "capture.sphere_cut")]
    assert said == code and (capture.open_mask(0) is None) == bool(code)
    if code:
        told = load_capture(tiny.folder, mask_meaning=MaskMeaning.OBJECT)
        assert "capture.masks_hardly_fit" in codes(told.warnings) and told.open_mask(0) is not None


@pytest.mark.parametrize("count", [1, 2])
def test_photos_with_white_masks_are_left_out(ball, count):
    for i in range(count):
        Image.fromarray(np.full((SIZE, SIZE), 255, np.uint8)).save(ball.folder / f"masks/{i:03d}.png")
    capture = load_capture(ball.folder)
    rays = PixelRays.from_capture(capture, 10_000, True)
    (news,) = (message for message in rays.warnings if "masks" in message.code)
    assert news.code == "capture.masks_full" and news.values["names"] == [f"{i:03d}" for i in range(count)]
    assert not any(rays.valid[rays.offset[i] : rays.offset[i + 1]].any() for i in range(count))
    assert capture.bounds_source == "masks" and "capture.masks_unclear" not in codes(capture.warnings)


def alpha_of(tiny: TinyCapture, alpha: list[np.ndarray]) -> None:
    for i, one in enumerate(alpha):
        path = tiny.folder / f"images/{i:03d}.png"
        photo = np.asarray(Image.open(path).convert("RGB"))
        Image.fromarray(np.dstack([photo, np.uint8(255) * one])).save(path)


def test_alpha_that_hides_a_corner_is_no_cut_out(ball):
    shutil.rmtree(ball.folder / "masks")
    corner = np.ones((SIZE, SIZE), bool)
    corner[:6, :9] = False
    alpha_of(ball, [corner] * VIEWS)
    capture = load_capture(ball.folder)
    rays = PixelRays.from_capture(capture, 10_000, True)
    assert "capture.alpha_usable" in codes(capture.warnings) and rays.background and rays.mask is None
    assert int((~rays.valid).sum()) == VIEWS * 6 * 9


def test_masks_count_before_alpha_that_hides_the_object(ball):
    expected = truth(ball)
    alpha_of(ball, [~mask for mask in expected])
    capture = load_capture(ball.folder)
    rays = PixelRays.from_capture(capture, 10_000, True)
    assert "capture.alpha_inverted" in codes(capture.warnings) and rays.background
    assert int((rays.mask > 127).sum()) == sum(int(mask.sum()) for mask in expected)


def test_masks_in_a_folder_of_their_own_are_found(ball):
    (ball.folder / "masks").rename(ball.folder / "inner")
    (ball.folder / "masks").mkdir()
    (ball.folder / "inner").rename(ball.folder / "masks/set 1")
    assert all(view.mask_path for view in load_capture(ball.folder).views)


def test_masks_that_are_missing_end_nothing_that_ignores_them(ball):
    shutil.rmtree(ball.folder / "masks")
    for i, frame in enumerate(ball.meta["frames"]):
        frame["mask_path"] = f"masks/{i:03d}.png"
    with pytest.raises(CaptureError, match=r"mask masks/000\.png is missing, and 5 more"):
        load_capture(ball.save())
    assert len(load_capture(ball.folder, use_masks=False).views) == VIEWS


@pytest.mark.parametrize("inverted", [False, True], ids=["cut-out", "inverted"])
def test_a_cut_out_among_photos_with_masks_is_its_own_mask(ball, inverted):
    """What was cut away is not learned as black, and the other photos show the surroundings. Inverted alpha is no mask."""
    expected = truth(ball)
    (ball.folder / "masks/002.png").unlink()
    path = ball.folder / "images/002.png"
    photo = np.asarray(Image.open(path).convert("RGB"))
    Image.fromarray(np.dstack([photo, np.uint8(255) * (expected[2] != inverted)])).save(path)
    rays = PixelRays.from_capture(load_capture(ball.folder), 10_000, True)
    of_photo = slice(rays.offset[2], rays.offset[3])
    shown = rays.valid[of_photo].numpy().reshape(SIZE, SIZE)
    if inverted:
        assert "capture.masks_lacking" in codes(rays.warnings) and not shown.any() and rays.background
        return
    (news,) = (message for message in rays.warnings if "mask" in message.code)
    assert news.code == "capture.alpha_for_mask" and news.values["names"] == ["002"] and rays.background
    assert (shown == expected[2]).all() and (rays.mask[of_photo].numpy()[shown.ravel()] == 255).all()
    assert rays.valid[: rays.offset[2]].all(), "the other photos are whole"
