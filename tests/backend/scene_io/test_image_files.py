"""Image files through Blender and without it: other programs read the same values, and no half file is left."""

import json
import sys
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from support.captures import write_exr
from support.own_process import in_blender

GRAY = np.arange(256, dtype=np.uint8).reshape(8, 32)
COLOR = np.random.default_rng(0).integers(0, 256, (37, 21, 3)).astype(np.uint8)
RADIANCE = np.random.default_rng(1).random((40, 50, 3)) * 4
HALF = np.concatenate([RADIANCE, np.full((40, 50, 1), 0.5)], axis=-1).astype(np.float16)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Folders with what one Blender has written, and what it has read."""
    folder = tmp_path_factory.mktemp("images")
    for name in ("pngs", "photo", "pixels", "errors"):
        (folder / name).mkdir()
    write_exr(folder / "pixels" / "half.exr", HALF)
    Image.fromarray(COLOR).save(folder / "pixels" / "color.png")
    (folder / "errors" / "torn.exr").write_bytes(b"\x76\x2f\x31\x01torn")
    (folder / "errors" / "file").touch()
    for name in ("folder.png", "folder.exr"):
        (folder / "errors" / name).mkdir()
    in_blender(use_files, folder)
    return folder


def use_files(folder):
    for use, name in ((write_pngs, "pngs"), (write_photo, "photo"), (read_pixels, "pixels"), (find_errors, "errors")):
        use(Path(folder) / name)


def test_png_keeps_every_value(folder):
    for name, pixels in (("gray", GRAY), ("color", COLOR)):
        found = np.asarray(Image.open(folder / "pngs" / f"{name}.png"))
        np.testing.assert_array_equal(found, pixels)


def write_pngs(folder):
    from backend.scene_io.image_files import write_png

    write_png(folder / "gray.png", GRAY)
    write_png(folder / "color.png", COLOR)


def test_photos_are_half_floats_in_dwaa(folder):
    file = OpenEXR.File(str(folder / "photo" / "photo.exr"), separate_channels=True)
    assert file.header()["compression"] == OpenEXR.DWAA_COMPRESSION and set(file.channels()) == {"R", "G", "B"}
    found = np.stack([file.channels()[name].pixels for name in "RGB"], axis=-1)
    assert found.dtype == np.float16
    assert np.abs(found - RADIANCE).mean() < 0.02 and np.abs(found - RADIANCE).max() < 0.2, "DWAA is lossy, but not much"


def write_photo(folder):
    import bpy

    from backend.scene_io.image_files import write_half_exr

    before = bpy.context.scene.render.image_settings.file_format
    write_half_exr(folder / "photo.exr", RADIANCE)
    assert bpy.context.scene.render.image_settings.file_format == before
    assert len(bpy.data.scenes) == 1 and "nep.save" not in bpy.data.images


def read_pixels(folder):
    from backend.scene_io.image_files import load_pixels

    for name in ("half.exr", "color.png"):
        np.save(folder / f"{name}.npy", load_pixels(folder / name))


def test_pixels_are_read_as_they_are_stored(folder):
    np.testing.assert_array_equal(np.load(folder / "pixels" / "half.exr.npy"), HALF)
    found = np.load(folder / "pixels" / "color.png.npy")
    np.testing.assert_allclose(found[..., :3], COLOR / 255, atol=1e-6)
    assert (found[..., 3] == 1).all()


def find_errors(folder):
    from backend.scene_io.image_files import load_pixels, write_half_exr, write_png

    messages = []
    for call in (
        lambda: load_pixels(folder / "torn.exr"),
        lambda: load_pixels(folder / "missing.exr"),
        lambda: write_png(folder / "file" / "a.png", GRAY),
        lambda: write_png(folder / "folder.png", GRAY),
        lambda: write_half_exr(folder / "file" / "a.exr", RADIANCE),
        lambda: write_half_exr(folder / "folder.exr", RADIANCE),
    ):
        try:
            call()
            messages.append("no error")
        except OSError as error:
            messages.append(str(error))
    folder.with_name("errors.json").write_text(json.dumps(messages))


def test_an_unusable_file_is_an_oserror_and_leaves_nothing(folder):
    messages = json.loads((folder / "errors.json").read_text())
    assert len(messages) == 6 and all(str(folder / "errors") in message for message in messages), messages
    left = sorted(path.name for path in (folder / "errors").iterdir())
    assert left == ["file", "folder.exr", "folder.png", "torn.exr"]


def test_nothing_is_written_through_a_link(tmp_path):
    """A shelf from a stranger may hold links to files of the user, also under the temporary names."""
    in_blender(write_where_links_are, tmp_path)
    assert (tmp_path / "mine").read_text() == "mine"
    assert not [path.name for path in tmp_path.iterdir() if path.is_symlink()]


def write_where_links_are(folder):
    from backend.headless.blend_file import save_packed
    from backend.scene_io.image_files import write_half_exr, write_png

    (Path(folder) / "mine").write_text("mine")
    for name in ("a.png", "b.exr", "c.blend"):
        for link in (name, f"{name}.partial" if name != "c.blend" else f"partial_{name}"):
            (Path(folder) / link).symlink_to(Path(folder) / "mine")
    write_png(Path(folder) / "a.png", GRAY)
    write_half_exr(Path(folder) / "b.exr", RADIANCE)
    save_packed(Path(folder) / "c.blend")


if __name__ == "__main__":
    globals()[sys.argv[1]](*sys.argv[2:])
