"""What photo files tell of the camera and of exposures."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from PIL import ExifTags, Image
from PIL.TiffImagePlugin import IFDRational

from blender_nep.capture import load_capture
from blender_nep.capture.camera_settings import expected_response, told_exposures, told_gains
from blender_nep.capture.exposure import Exposures

MADE = {ExifTags.Base.Make: "Acme", ExifTags.Base.Model: "One"}
SECONDS = (IFDRational(1, 100), IFDRational(1, 50), IFDRational(1, 25), IFDRational(1, 100))
ISO_400 = {ExifTags.Base.ISOSpeedRatings: 400, ExifTags.Base.FNumber: IFDRational(8)}


@pytest.fixture
def taken(make_capture):
    """taken(suffix, tags of each photo) is a capture whose photos are such files."""

    def of(suffix, *tags):
        capture = replace(load_capture(make_capture(views=4, size=16).folder), color_space="srgb")
        views = []
        for view, own in zip(capture.views, tags if len(tags) > 1 else 4 * tags, strict=True):
            exif = Image.Exif()
            for tag, value in own.items():
                (exif if tag in MADE else exif.get_ifd(ExifTags.IFD.Exif))[tag] = value
            path = capture.folder / f"{view.name}{suffix}"
            Image.new("RGB", (16, 16), (90, 120, 60)).save(path, exif=exif)
            views.append(replace(view, image_path=path))
        return replace(capture, views=views)

    return of


def test_a_photo_that_names_its_camera_has_its_curve(taken):
    capture = taken(".jpg", MADE)
    assert expected_response(capture) == 1
    Image.new("RGB", (16, 16)).save(capture.views[3].image_path)
    assert expected_response(capture) == 0.5, "one of the photos does not"


def test_the_maker_alone_is_not_enough(taken):
    assert expected_response(taken(".jpg", {ExifTags.Base.Make: "Acme"})) == 0.5


def test_nothing_is_expected_of_lossless_photos(taken):
    assert expected_response(taken(".png", {})) == 0


def test_linear_photos_have_no_curve(taken):
    capture = taken(".jpg", MADE)
    assert expected_response(replace(capture, color_space="linear")) is None
    rendered = sorted((capture.folder / "images").iterdir())
    views = [replace(view, image_path=path) for view, path in zip(capture.views, rendered, strict=True)]
    assert expected_response(replace(capture, views=views)) is None, "OpenEXR"


def test_gains_are_told_by_time_iso_and_f_number(taken):
    said = [ISO_400 | {ExifTags.Base.ExposureTime: seconds} for seconds in SECONDS]
    said[3] |= {ExifTags.Base.ISOSpeedRatings: 800, ExifTags.Base.FNumber: IFDRational(4)}
    relative = np.array([1, 2, 4, 8.0])
    np.testing.assert_allclose(told_gains(taken(".jpg", *said)), relative / relative.prod() ** 0.25, rtol=1e-6)


@pytest.mark.parametrize("missing", [*ISO_400, ExifTags.Base.ExposureTime])
def test_one_photo_that_tells_too_little_is_enough(taken, missing):
    whole = ISO_400 | {ExifTags.Base.ExposureTime: IFDRational(1, 60)}
    less = {tag: value for tag, value in whole.items() if tag != missing}
    assert told_gains(taken(".jpg", whole, whole, less, whole)) is None


def compared(log):
    """What the surroundings tell: logarithms [views, 3] of gains."""
    return SimpleNamespace(log=log - log.mean(0), exposures=lambda device: Exposures(None))


TOLD = np.exp(np.array([-0.5, 0.0, 0.2, 0.3]))


def test_told_exposures_count_where_the_surroundings_agree():
    near = np.log(TOLD)[:, None] + np.array([0.1, -0.1, 0.05, -0.05])[:, None] + np.zeros(3)
    for surroundings in (None, compared(near)):
        found = told_exposures(TOLD, surroundings, "cpu")
        torch.testing.assert_close(found.gain, torch.from_numpy(TOLD).float()[:, None].expand(4, 3))


def test_told_exposures_do_not_count_with_a_flash():
    assert told_exposures(TOLD, compared(np.zeros((4, 3))), "cpu") is None, "all photos are equally bright"


def test_told_exposures_do_not_count_in_a_changing_light():
    dimmer = np.log(TOLD) - [0, 0, 0, 0.6]
    assert told_exposures(TOLD, compared(dimmer[:, None] + np.zeros(3)), "cpu") is None


def test_equal_told_exposures_say_nothing():
    assert told_exposures(np.ones(4), compared(np.log(TOLD)[:, None] + np.zeros(3)), "cpu") is None
    assert told_exposures(None, None, "cpu") is None


def test_the_white_balance_comes_from_the_surroundings():
    balance = 0.2 * np.array([[1, 0, -1], [-1, 0, 1], [1, -2, 1], [-1, 2, -1.0]])
    found = told_exposures(TOLD, compared(np.log(TOLD)[:, None] + balance), "cpu")
    torch.testing.assert_close(found.gain.log(), torch.from_numpy(np.log(TOLD)[:, None] + balance).float())
