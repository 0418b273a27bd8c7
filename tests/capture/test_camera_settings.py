"""What photo files tell of the camera's tone curve."""

from dataclasses import replace

from PIL import ExifTags, Image

from blender_nep.capture.camera_settings import expected_response

MADE = {ExifTags.Base.Make: "Acme", ExifTags.Base.Model: "One"}


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
