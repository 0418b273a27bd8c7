"""The size of an image from its header, as the library finds it too."""

import struct

import numpy as np
import pytest
import tifffile
from PIL import Image

from backend.scene_io.photos import formats
from backend.scene_io.photos.image_size import image_size
from blender_nep.capture.photos import photo_files
from support.captures import write_exr
from support.icc import SRGB, SRGB_CURVE, rgb_profile


@pytest.mark.parametrize(
    "name",
    ["a.png", "a.jpg", "progressive.jpg", "a.exr", "a.webp", "lossless.webp", "alpha.webp", "a.tif", "lzw.tif", "big.tif"],
)
def test_image_size_of_a_header(tmp_path, name):
    pixels = np.zeros((7, 13, 3))
    if name.endswith("exr"):
        write_exr(tmp_path / name, pixels)
    else:
        keywords = {"progressive": {"progressive": True}, "lossless": {"lossless": True}, "lzw": {"compression": "tiff_lzw"}}
        keywords["big"] = {"big_tiff": True}
        mode = "RGBA" if name.startswith("alpha") else "RGB"
        image = Image.fromarray(pixels.astype(np.uint8)).convert(mode)
        if mode == "RGBA":
            image.putalpha(40)
        image.save(tmp_path / name, **keywords.get(name.split(".")[0], {}))
    assert image_size(tmp_path / name) == photo_files.image_size(tmp_path / name) == (13, 7)
    (tmp_path / name).write_bytes((tmp_path / name).read_bytes()[:18])
    with pytest.raises(OSError, match="damaged"):
        image_size(tmp_path / name)


def test_a_photo_of_a_phone_has_megabytes_before_its_size(tmp_path):
    Image.new("RGB", (13, 7)).save(tmp_path / "a.jpg")
    photo = (tmp_path / "a.jpg").read_bytes()
    segment = b"\xff\xe1" + struct.pack(">H", 65_000) + bytes(64_998)
    (tmp_path / "a.jpg").write_bytes(photo[:2] + 30 * segment + b"\xff" + photo[2:])  # and a fill byte before a marker
    assert image_size(tmp_path / "a.jpg") == photo_files.image_size(tmp_path / "a.jpg") == (13, 7)


def test_text_is_no_image(tmp_path):
    (tmp_path / "a.png").write_bytes(struct.pack(">I", 1) + b"hello")
    with pytest.raises(OSError, match="no PNG"):
        image_size(tmp_path / "a.png")


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize(("kind", "with_profile"), [("float32", False), ("float32", True), ("uint16", False)])
def test_a_tiff_header_says_what_the_library_finds(tmp_path, kind, with_profile, order, big):
    icc = rgb_profile(SRGB, SRGB_CURVE)
    extra = [(34675, 7, len(icc), icc, True)] if with_profile else []
    path = tmp_path / "a.tif"
    tifffile.imwrite(path, np.ones((7, 13, 3), kind), photometric="rgb", byteorder=order, bigtiff=big, extratags=extra)
    linear = photo_files.is_linear(path)
    assert linear == (kind == "float32" and not with_profile)
    header = formats.TiffHeader(path)
    assert header.size == (13, 7) and header.is_linear == linear
    assert formats.color_space(path) == ("linear" if linear else "srgb")


def test_formats_are_those_of_the_library():
    assert {*formats.SHOWN, *formats.HEIF, *formats.RAW} == set(photo_files.SUFFIXES)
