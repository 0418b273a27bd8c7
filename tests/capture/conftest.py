"""Captures whose photo files tell of their camera."""

from dataclasses import replace

import pytest
from PIL import ExifTags, Image

from blender_nep.capture import load_capture

OF_THE_CAMERA = (ExifTags.Base.Make, ExifTags.Base.Model, ExifTags.Base.DateTime)


@pytest.fixture
def taken(make_capture):
    """taken(suffix, tags of each photo) is a capture whose photos are such files."""

    def of(suffix, *tags):
        capture = replace(load_capture(make_capture(views=4, size=16).folder), color_space="srgb")
        views = []
        for view, own in zip(capture.views, tags if len(tags) > 1 else 4 * tags, strict=True):
            exif = Image.Exif()
            for tag, value in own.items():
                (exif if tag in OF_THE_CAMERA else exif.get_ifd(ExifTags.IFD.Exif))[tag] = value
            path = capture.folder / f"{view.name}{suffix}"
            Image.new("RGB", (16, 16), (90, 120, 60)).save(path, exif=exif)
            views.append(replace(view, image_path=path))
        return replace(capture, views=views)

    return of
