"""Image files through Blender and without it: other programs read the same values, and no half file is left."""

import sys
from pathlib import Path

import numpy as np
import OpenEXR
from PIL import Image

from support.captures import write_exr
from support.own_process import in_blender

GREY = np.arange(256, dtype=np.uint8).reshape(8, 32)
COLOR = np.random.default_rng(0).integers(0, 256, (37, 21, 3)).astype(np.uint8)
RADIANCE = np.random.default_rng(1).random((40, 50, 3)) * 4


def test_png_keeps_every_value(tmp_path):
    in_blender(write_pngs, tmp_path)
    for name, pixels in (("grey", GREY), ("color", COLOR)):
        found = np.asarray(Image.open(tmp_path / f"{name}.png"))
        np.testing.assert_array_equal(found, pixels)


def write_pngs(folder):
    from backend.scene_io.image_files import write_png

    write_png(Path(folder) / "grey.png", GREY)
    write_png(Path(folder) / "color.png", COLOR)


def test_photos_are_half_floats_in_dwaa(tmp_path):
    in_blender(write_photo, tmp_path)
    file = OpenEXR.File(str(tmp_path / "photo.exr"), separate_channels=True)
    assert file.header()["compression"] == OpenEXR.DWAA_COMPRESSION and set(file.channels()) == {"R", "G", "B"}
    found = np.stack([file.channels()[name].pixels for name in "RGB"], axis=-1)
    assert found.dtype == np.float16
    assert np.abs(found - RADIANCE).mean() < 0.02 and np.abs(found - RADIANCE).max() < 0.2, "DWAA is lossy, but not much"


def write_photo(folder):
    import bpy

    from backend.scene_io.image_files import write_half_exr

    before = bpy.context.scene.render.image_settings.file_format
    write_half_exr(Path(folder) / "photo.exr", RADIANCE)
    assert bpy.context.scene.render.image_settings.file_format == before
    assert len(bpy.data.scenes) == 1 and "nep.save" not in bpy.data.images


def test_pixels_are_read_as_they_are_stored(tmp_path):
    radiance = np.concatenate([RADIANCE, np.full((40, 50, 1), 0.5)], axis=-1).astype(np.float16)
    write_exr(tmp_path / "half.exr", radiance)
    Image.fromarray(COLOR).save(tmp_path / "color.png")
    np.save(tmp_path / "half.npy", radiance)
    in_blender(check_pixels, tmp_path)


def check_pixels(folder):
    from backend.scene_io.image_files import load_pixels

    np.testing.assert_array_equal(load_pixels(Path(folder) / "half.exr"), np.load(Path(folder) / "half.npy"))
    found = load_pixels(Path(folder) / "color.png")
    np.testing.assert_allclose(found[..., :3], COLOR / 255, atol=1e-6)
    assert (found[..., 3] == 1).all()


def test_a_file_that_cannot_be_read_or_written_is_an_oserror_and_leaves_nothing(tmp_path):
    (tmp_path / "torn.exr").write_bytes(b"\x76\x2f\x31\x01torn")
    (tmp_path / "file").touch()
    for name in ("folder.png", "folder.exr"):
        (tmp_path / name).mkdir()
    in_blender(check_errors, tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file", "folder.exr", "folder.png", "torn.exr"]


def check_errors(folder):
    from backend.scene_io.image_files import load_pixels, write_half_exr, write_png

    folder = Path(folder)
    for call in (
        lambda: load_pixels(folder / "torn.exr"),
        lambda: load_pixels(folder / "missing.exr"),
        lambda: write_png(folder / "file" / "a.png", GREY),
        lambda: write_png(folder / "folder.png", GREY),
        lambda: write_half_exr(folder / "file" / "a.exr", RADIANCE),
        lambda: write_half_exr(folder / "folder.exr", RADIANCE),
    ):
        try:
            call()
        except OSError as error:
            assert str(folder) in str(error), error
        else:
            raise AssertionError("no error")


if __name__ == "__main__":
    globals()[sys.argv[1]](*sys.argv[2:])
