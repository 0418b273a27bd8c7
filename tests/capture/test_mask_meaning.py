"""What masks mean is recognized, and said. Object masks are believed as before."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from blender_nep import cli
from blender_nep.capture.loading import load_capture
from blender_nep.capture.mask_meaning import read_photo_masks
from blender_nep.capture.photos.mask_files import MaskMeaning, MaskRaster
from blender_nep.capture.rays.pixel_rays import PixelRays
from support.captures import CENTER

SIZE = 48
OFF = CENTER + np.array([0.25, -0.1, 0.1])
"""A ball here looks different in every photo of the tiny capture."""


def silhouettes(tiny, center: np.ndarray = OFF, radius: float = 0.4) -> list[np.ndarray]:
    """Which pixels [h, w] bool show a ball, in each photo."""
    rows, columns = np.mgrid[:SIZE, :SIZE] + 0.5
    shown = []
    for view in load_capture(tiny.folder, use_masks=False).views:
        direction = view.camera.directions(columns.ravel(), rows.ravel())
        to_center = center - view.camera.position
        beside = np.linalg.norm(to_center - (direction @ to_center)[:, None] * direction, axis=1)
        shown.append((beside < radius).reshape(SIZE, SIZE))
    return shown


def with_masks(tiny, masks, write=lambda mask, path: Image.fromarray(np.uint8(255) * mask).save(path), ending="png"):
    """The folder of the capture with these masks [h, w] bool, which transforms.json names."""
    for number, (frame, mask) in enumerate(zip(tiny.meta["frames"], masks, strict=True)):
        frame["mask_path"] = f"masks/{number:03d}.{ending}"
        write(mask, tiny.folder / frame["mask_path"])
    return tiny.save()


def said(capture) -> list[str]:
    return [warning.code.removeprefix("capture.") for warning in capture.warnings if "masks" in warning.code]


@pytest.fixture(params=[True, False], ids=["sphere", "no sphere"])
def tiny(make_capture, request):
    return make_capture(views=9, size=SIZE, suffix=".png", bounds=request.param)


@pytest.fixture
def ball(make_capture):
    """`tiny` with a sphere, for what does not depend on where the sphere comes from."""
    return make_capture(views=9, size=SIZE, suffix=".png")


def rays_of(capture) -> PixelRays:
    return PixelRays.from_capture(capture, 10**6, use_masks=True)


def test_masks_of_the_object_are_believed_without_a_word(tiny):
    masks = silhouettes(tiny)
    masks[4] = np.zeros_like(masks[4])
    masks[6][:12, :9] ^= True
    capture = load_capture(with_masks(tiny, masks))
    assert capture.mask_reading.meaning == MaskMeaning.OBJECT and not said(capture)
    assert torch.equal(rays_of(capture).mask[: SIZE * SIZE] > 127, torch.from_numpy(masks[0].ravel()))


@pytest.mark.parametrize(("center", "radius"), [(OFF, 0.4), (CENTER, 0.4), (CENTER + 0.05, 0.12), (OFF, 0.9)])
def test_inverted_masks_are_turned(tiny, center, radius):
    """Small objects and such that reach over the borders, too."""
    masks = silhouettes(tiny, center, radius)
    right = load_capture(with_masks(tiny, masks))
    expected = rays_of(right).mask
    inverted = load_capture(with_masks(tiny, [~mask for mask in masks]))
    assert inverted.mask_reading.meaning == MaskMeaning.BACKGROUND and said(inverted)[0] == "masks_background"
    assert torch.equal(rays_of(inverted).mask, expected)
    assert inverted.bounds_source == right.bounds_source
    np.testing.assert_array_equal(inverted.object_center, right.object_center)


@pytest.mark.parametrize("radius", [0.7, 0.9])
def test_masks_of_an_object_that_fills_photos_are_believed(tiny, radius):
    masks = silhouettes(tiny, OFF, radius)
    assert np.mean(masks) > 0.5 or radius < 0.9
    capture = load_capture(with_masks(tiny, masks))
    assert capture.mask_reading.meaning == MaskMeaning.OBJECT and rays_of(capture).mask is not None


def blank() -> np.ndarray:
    return np.ones((SIZE, SIZE), bool)


def people(number: int) -> np.ndarray:
    """Someone walks through the photos."""
    mask = blank()
    mask[10:40, (7 * number) % 40 : (7 * number) % 40 + 10] = False
    return mask


def blemishes(number: int) -> np.ndarray:
    return np.random.default_rng(number).random((SIZE, SIZE)) > 0.02


def rig(_: int) -> np.ndarray:
    """The rim of a lens, the same in every photo."""
    row, column = np.mgrid[:SIZE, :SIZE] + 0.5
    return np.hypot(row - SIZE / 2, column - SIZE / 2) < SIZE / 2


def frame(number: int) -> np.ndarray:
    """Black borders, as undistorted photos have them."""
    edge = 1 + number % 4
    return np.pad(blank()[2 * edge :, 2 * edge :], edge)


def rarely(number: int) -> np.ndarray:
    """Black in one photo only."""
    return people(1) if number == 2 else blank()


@pytest.mark.parametrize("draw", [people, blemishes, rig, frame, rarely])
def test_masks_of_what_may_be_used_leave_black_out(tiny, draw):
    masks = [draw(number) for number in range(9)]
    plain = load_capture(tiny.folder)
    capture = load_capture(with_masks(tiny, masks))
    assert capture.mask_reading.meaning == MaskMeaning.USABLE and said(capture) == ["masks_usable"]
    (percent,) = (warning.values["percent"] for warning in capture.warnings if warning.code == "capture.masks_usable")
    assert percent == pytest.approx(100 * (1 - np.mean(masks)))
    rays = rays_of(capture)
    assert rays.mask is None
    assert torch.equal(rays.valid, torch.from_numpy(np.stack(masks).ravel()))
    assert capture.bounds_source == plain.bounds_source and capture.object_radius == plain.object_radius


def test_masks_that_would_leave_most_of_the_photos_out_do_not(ball):
    """One small window for all photos."""
    mask = np.zeros((SIZE, SIZE), bool)
    mask[10:30, 15:40] = True
    folder = with_masks(ball, [mask] * 9)
    for entry in ball.meta["frames"]:
        entry["mask_path"] = "masks/000.png"
    capture = load_capture(ball.save())
    assert capture.mask_reading.meaning == MaskMeaning.NOTHING and rays_of(capture).valid.all()
    assert said(capture) == ["masks_one_for_all", "masks_not_used"] and folder == capture.folder


def test_white_masks_are_passed_over(ball):
    capture = load_capture(with_masks(ball, [blank()] * 9))
    assert said(capture) == ["masks_white"] and rays_of(capture).mask is None and capture.bounds_source != "masks"


def test_masks_that_may_mean_two_things_are_passed_over(tiny):
    """Black is a stand below the place where the cameras look: it may be the object, or something to leave out."""
    masks = [~mask for mask in silhouettes(tiny, CENTER - [0, 0, 0.6], 0.3)]
    capture = load_capture(with_masks(tiny, masks))
    assert capture.mask_reading.meaning == MaskMeaning.NOTHING and said(capture) == ["masks_doubtful"]
    assert rays_of(capture).mask is None and rays_of(capture).valid.all()


def test_equal_masks_in_the_middle_are_believed_with_a_warning(ball):
    mask = np.zeros((SIZE, SIZE), bool)
    mask[14:34, 14:34] = True
    capture = load_capture(with_masks(ball, [mask] * 9))
    assert capture.mask_reading.meaning == MaskMeaning.OBJECT and said(capture) == ["masks_alike"]


@pytest.mark.parametrize("meaning", ["object", "background", "usable"])
def test_what_the_artist_says_counts(ball, meaning):
    masks = silhouettes(ball)
    capture = load_capture(with_masks(ball, masks), mask_meaning=MaskMeaning(meaning), sphere=(CENTER, 0.8))
    assert capture.mask_reading.meaning == meaning
    assert said(capture) == ([] if meaning == "object" else ["masks_as_told"])
    rays, first = rays_of(capture), torch.from_numpy(masks[0].ravel())
    if meaning == "usable":
        assert rays.mask is None and torch.equal(rays.valid[: SIZE * SIZE], first)
    else:
        assert torch.equal(rays.mask[: SIZE * SIZE] > 127, first == (meaning == "object"))


def stored(white: int, kind: type):
    return lambda mask, path: Image.fromarray((mask * white).astype(kind)).save(path)


@pytest.mark.parametrize(("white", "kind"), [(1, np.uint8), (100, np.uint8), (1, np.uint16), (255, np.uint16)])
def test_white_may_be_a_small_value(ball, white, kind):
    masks = silhouettes(ball)
    capture = load_capture(with_masks(ball, masks, stored(white, kind)))
    assert said(capture) == ["masks_dim"] and set(rays_of(capture).mask.tolist()) == {0, 255}
    assert torch.equal(rays_of(capture).mask > 127, torch.from_numpy(np.stack(masks).ravel()))


def test_empty_masks_still_end_with_a_message(ball):
    capture = load_capture(with_masks(ball, [~blank()] * 9))
    with pytest.raises(Exception, match="masks are empty"):
        rays_of(capture)


def test_noise_of_jpeg_masks_is_cleaned(ball):
    masks = silhouettes(ball, CENTER)
    folder = with_masks(ball, masks, lambda mask, path: Image.fromarray(np.uint8(255) * mask).save(path, quality=80), "jpg")
    capture = load_capture(folder)
    assert not said(capture) and MaskRaster.of(folder / "masks/000.jpg").noisy
    mask = rays_of(capture).mask[: SIZE * SIZE].numpy()
    as_stored = np.asarray(Image.open(folder / "masks/000.jpg")).ravel()
    assert ((mask > 0) & (mask < 255)).sum() < 0.5 * ((as_stored > 0) & (as_stored < 255)).sum()
    assert (((mask > 127) != masks[0].ravel()).mean()) < 0.02


def test_inverted_masks_of_photos_without_cameras_are_turned(ball, tmp_path):
    paths = []
    for number, mask in enumerate(silhouettes(ball)):
        paths.append(tmp_path / f"{number}.png")
        Image.fromarray((~mask).astype(np.uint8)).save(paths[-1])
    reading, messages = read_photo_masks(paths)
    assert (reading.meaning, reading.white) == (MaskMeaning.BACKGROUND, pytest.approx(1 / 255))
    assert [message.code for message in messages] == ["capture.masks_dim", "capture.masks_background"]
    for number, mask in enumerate(silhouettes(ball)):
        Image.fromarray(mask).save(paths[number])
    assert read_photo_masks(paths)[0].meaning == MaskMeaning.OBJECT
    for number in range(9):
        Image.fromarray(people(number)).save(paths[number])
    assert read_photo_masks(paths)[0].meaning == MaskMeaning.OBJECT


@pytest.mark.parametrize(("option", "meaning"), [("use", "background"), ("object", "object"), ("ignore", None)])
def test_info_says_what_masks_mean(ball, capsys, option, meaning):
    folder = with_masks(ball, [~mask for mask in silhouettes(ball)])
    assert cli.main(["info", str(folder), "--json", "--masks", option, *sphere_options()]) == 0
    found = json.loads(capsys.readouterr().out)
    codes = [warning["code"] for warning in found["warnings"]]
    assert found["mask_meaning"] == meaning and found["masks"] == (meaning is not None)
    assert ("capture.masks_background" in codes) == (option == "use")
    assert ("capture.masks_as_told" in codes) == (option == "object")


def sphere_options() -> list[str]:
    return ["--object-center", *(f"{x:g}" for x in CENTER), "--object-radius", "0.8"]


def test_a_description_of_usable_masks_says_so(ball, capsys):
    folder: Path = with_masks(ball, [people(number) for number in range(9)])
    assert cli.main(["info", str(folder)]) == 0
    told = capsys.readouterr().out
    assert (
        "masks          none, white is what may be used" in told and "warning: white in the masks is not the object" in told
    )
