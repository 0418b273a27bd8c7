"""The size of an image from its header, as the library finds it too."""

import struct

import numpy as np
import pytest
from PIL import Image

from backend.scene_io.image_size import image_size
from blender_nep.capture import photo_files
from support.captures import write_exr


@pytest.mark.parametrize("name", ["a.png", "a.jpg", "progressive.jpg", "a.exr"])
def test_image_size_of_a_header(tmp_path, name):
    pixels = np.zeros((7, 13, 3))
    if name.endswith("exr"):
        write_exr(tmp_path / name, pixels)
    else:
        keywords = {"progressive": True} if name.startswith("progressive") else {}
        Image.fromarray(pixels.astype(np.uint8)).save(tmp_path / name, **keywords)
    assert image_size(tmp_path / name) == photo_files.image_size(tmp_path / name) == (13, 7)
    (tmp_path / name).write_bytes((tmp_path / name).read_bytes()[:18])
    with pytest.raises(OSError, match="damaged"):
        image_size(tmp_path / name)


def test_text_is_no_image(tmp_path):
    (tmp_path / "a.png").write_bytes(struct.pack(">I", 1) + b"hello")
    with pytest.raises(OSError, match="no PNG"):
        image_size(tmp_path / "a.png")
