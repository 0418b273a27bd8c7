"""Camera raw files, and which way photos of all formats are turned."""

import importlib.util
import io
import struct
import sys

import numpy as np
import OpenEXR
import pillow_heif
import pytest
import tifffile
from PIL import Image

from blender_nep.cameras.photo_folder import Photo, find_photos, gray_copy
from blender_nep.cameras.reduction import Reduction
from blender_nep.capture import load_capture
from blender_nep.capture.photos.photo_files import exif, image_size, open_image
from blender_nep.errors import CaptureError
from support.raw_photo import WHITE, write_dng
from support.recorded_rows import record_rows

needs_rawpy = pytest.mark.skipif(importlib.util.find_spec("rawpy") is None, reason="the extra `raw` is not installed")

MAKE, ORIENTATION, EXIF, FILM_LENGTH = 0x010F, 0x0112, 0x8769, 0xA405
TURNS = {1: 0, 6: 1, 3: 2, 8: 3}


def halves(left, right, size=(48, 80)):
    """An image [H, W, 3] with these colors in its left and right half."""
    image = np.empty((*size, 3))
    image[:, : size[1] // 2], image[:, size[1] // 2 :] = left, right
    return image


@needs_rawpy
@pytest.mark.parametrize("color_space", ["srgb", "linear"])
def test_raw_photos_are_developed_linear(tmp_path, color_space):
    """The sensor's values are radiance, of 14 bits, whatever else is in the photo: nothing is brightened."""
    left, right = np.array([0.5, 0.25, 0.125]), np.array([0.02, 0.03, 0.04])
    write_dng(tmp_path / "a.dng", np.round(WHITE * halves(left, right)))
    raster = open_image(tmp_path / "a.dng", color_space)
    assert raster.stored.dtype == np.uint16 and raster.size == (48, 80) and image_size(tmp_path / "a.dng") == (80, 48)
    color, alpha = raster.rows()
    assert alpha is None
    np.testing.assert_allclose(color[8:40, 8:32].mean((0, 1)), left, atol=1e-4)
    np.testing.assert_allclose(color[8:40, 48:72].mean((0, 1)), right, atol=1e-4)


@needs_rawpy
def test_a_capture_of_raw_photos_is_linear(make_capture):
    tiny = make_capture(suffix=".png")
    for frame in tiny.meta["frames"]:
        path = (tiny.folder / frame["file_path"]).with_suffix(".dng")
        write_dng(path, np.round(WHITE * halves((0.5, 0.5, 0.5), (0.1, 0.1, 0.1), (24, 24))))
        frame["file_path"] = frame["file_path"].replace(".png", ".dng")
    capture = load_capture(tiny.save())
    assert capture.color_space == "linear" and not capture.warnings
    first = tiny.meta["frames"][0]
    first["file_path"] = first["file_path"].replace(".dng", ".png")
    assert load_capture(tiny.save()).color_space == "srgb"


@needs_rawpy
def test_raw_photos_have_the_white_balance_of_the_camera(tmp_path):
    """A sensor that sees white as (0.5, 1, 0.8) shows a gray card gray."""
    neutral = np.array([0.5, 1.0, 0.8])
    write_dng(tmp_path / "a.dng", np.round(WHITE * halves(0.4 * neutral, 0.1 * neutral)), tuple(neutral))
    color, _ = open_image(tmp_path / "a.dng", "srgb").rows()
    card, dark = color[8:40, 8:32].mean((0, 1)), color[8:40, 48:72].mean((0, 1))
    np.testing.assert_allclose(card / card.mean(), 1, atol=0.01)
    np.testing.assert_allclose(card / dark, 4, rtol=0.01)


@needs_rawpy
def test_a_torn_raw_file_is_refused(tmp_path):
    write_dng(tmp_path / "a.dng", WHITE * halves((0.5, 0.5, 0.5), (0.1, 0.1, 0.1)))
    (tmp_path / "a.dng").write_bytes((tmp_path / "a.dng").read_bytes()[:3000])
    with pytest.raises(CaptureError, match=r"a.dng cannot be read as an image \(Input/output error\)"):
        open_image(tmp_path / "a.dng", "srgb")


@pytest.mark.parametrize("suffix", [".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".orf", ".rw2"])
def test_without_rawpy_the_message_says_what_to_install(tmp_path, monkeypatch, suffix):
    monkeypatch.setitem(sys.modules, "rawpy", None)
    path = tmp_path / f"photo{suffix}"
    path.write_bytes(b"raw")
    for read in (image_size, exif, lambda file: open_image(file, "srgb")):
        with pytest.raises(CaptureError, match=rf"photo{suffix} is a camera raw file") as caught:
            read(path)
        assert "pip install 'blender-nep[raw]'" in caught.value.hint


@needs_rawpy
def test_a_capture_of_raw_photos_loads(make_capture):
    tiny = make_capture(size=32)
    for frame in tiny.meta["frames"]:
        path = tiny.folder / frame["file_path"]
        radiance, _ = open_image(path, "linear").rows()
        write_dng(path.with_suffix(".dng"), np.round(WHITE * np.clip(radiance, 0, 1)))
        path.unlink()
        frame["file_path"] = frame["file_path"].replace(".exr", ".dng")
    capture = load_capture(tiny.save())
    radiance, _ = capture.load_photo(0)
    np.testing.assert_allclose(radiance[14:18, 14:18], 0.4, atol=2e-3)


def wrapped(kind):
    """EXIF in the place where a raw file of this kind has it."""
    tags = Image.Exif()
    tags[MAKE] = "Camera"
    tags.get_ifd(EXIF)[FILM_LENGTH] = 50
    tiff = tags.tobytes()[6:]
    if kind == "raf":
        preview = io.BytesIO()
        Image.new("RGB", (8, 8)).save(preview, "JPEG", exif=tags)
        head = b"FUJIFILMCCD-RAW 0201".ljust(84, b"\0")
        return head + struct.pack(">II", 200, len(preview.getvalue())) + bytes(200 - 92) + preview.getvalue()
    if kind == "cr3":
        more = Image.Exif()
        more[FILM_LENGTH] = 50
        boxes = [(b"CMT1", tiff), (b"CMT2", more.tobytes()[6:])]
        body = b"".join(struct.pack(">I", 8 + len(data)) + name + data for name, data in boxes)
        return struct.pack(">I", 24) + b"ftypcrx " + bytes(12) + body
    return {"orf": b"MMOR", "rw2": b"MMU\0"}.get(kind, b"MM\0*") + tiff[4:]


@needs_rawpy
@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("kind", ["cr3", "nef", "raf", "orf", "rw2"])
def test_the_focal_length_of_raw_files_is_found(tmp_path, monkeypatch, kind):
    """The files hold EXIF alone, in the layouts of their makers; LibRaw is played."""

    class Played:
        sizes = type("Sizes", (), {"flip": 6})

        def __enter__(self):
            return self

        def __exit__(self, *_):
            pass

    monkeypatch.setattr("rawpy.imread", lambda _: Played())
    path = tmp_path / f"a.{kind}"
    path.write_bytes(wrapped(kind))
    found = exif(path)
    assert (found[MAKE], found[FILM_LENGTH], found[ORIENTATION]) == ("Camera", 50, 6)
    path.write_bytes(wrapped(kind)[:40])
    assert exif(path) == {ORIENTATION: 6}


def write(path, orientation):
    """A photo whose left half is bright, with an orientation that EXIF says."""
    pixels = np.round(halves((230, 220, 210), (30, 20, 10))).astype(np.uint8)
    tags = Image.Exif()
    tags[MAKE], tags[ORIENTATION] = "Camera", orientation
    tags.get_ifd(EXIF)[FILM_LENGTH] = 50
    image = Image.fromarray(pixels)
    if path.suffix == ".dng":
        write_dng(path, pixels / 255 * WHITE, orientation=orientation, film=50)
    elif path.suffix == ".heic":
        pillow_heif.from_pillow(image).save(path, quality=-1, chroma=444, exif=tags.tobytes())
    elif path.suffix == ".tif":
        more = [(ORIENTATION, 3, 1, orientation, True), (MAKE, 2, 0, "Camera", True), (FILM_LENGTH, 3, 1, 50, True)]
        tifffile.imwrite(path, pixels, photometric="rgb", extratags=more)
    else:
        image.save(path, exif=tags, **({"lossless": True} if path.suffix == ".webp" else {"quality": 95}))


@pytest.mark.parametrize("orientation", TURNS)
@pytest.mark.parametrize("suffix", [".jpg", ".webp", ".tif", pytest.param(".dng", marks=needs_rawpy)])
def test_pixels_are_as_stored_and_exif_says_which_way_is_up(tmp_path, suffix, orientation):
    for number in range(3):
        write(tmp_path / f"{number}{suffix}", orientation)
    for photo in find_photos(tmp_path):
        assert (photo.width, photo.height) == image_size(photo.path) == (80, 48)
        assert photo.quarter_turns == TURNS[orientation] and photo.camera[0] in ("Camera", "Maker")
        assert photo.focal_length == pytest.approx(50 / 43.2666 * np.hypot(80, 48), rel=1e-4)
        color, _ = open_image(photo.path, "srgb").rows()
        assert color.shape == (48, 80, 3) and color[:, :32].min() > 0.5 > 0.2 > color[:, 48:].max()
        gray = gray_copy(photo, Reduction.of(80, 48, 40))
        assert gray.shape == (24, 40) and gray.dtype == np.uint8 and gray[:, :16].min() > gray[:, 24:].max() + 100


@pytest.mark.parametrize("orientation", TURNS)
def test_heic_is_turned_by_its_decoder_and_needs_no_turn(tmp_path, orientation):
    """The file says a turn twice, as those of phones: for the decoder and in EXIF. The second one must not count."""
    for number in range(3):
        write(tmp_path / f"{number}.heic", orientation)
    stored = np.round(halves((230, 220, 210), (30, 20, 10))).astype(np.uint8)
    upright = np.rot90(stored, -TURNS[orientation])
    for photo in find_photos(tmp_path):
        assert (photo.height, photo.width) == upright.shape[:2] and photo.quarter_turns == 0
        assert photo.camera[0] == "Camera" and photo.focal_length is not None
        raster = open_image(photo.path, "srgb")
        assert raster.size == upright.shape[:2] and np.abs(raster.stored.astype(int) - upright).max() <= 2
        gray = gray_copy(photo, Reduction.of(photo.width, photo.height, 80))
        assert np.abs(gray.astype(int) - upright.mean(-1)).max() <= 6


def test_a_photo_that_is_there_twice_counts_once(tmp_path):
    """The JPEG beside a raw file, and an export beside a HEIC, count as before raw and HEIC could be read."""
    for name in ("a.jpg", "b.jpg", "c.webp", "d.png", "d.jpg"):
        Image.new("RGB", (8, 8)).save(tmp_path / name)
    for name in ("a.CR2", "b.heic", "b.dng", "c.nef"):
        (tmp_path / name).write_bytes(b"not looked at")
    assert [photo.path.name for photo in find_photos(tmp_path)] == ["a.jpg", "b.jpg", "c.webp", "d.jpg", "d.png"]


def test_gray_copies_of_floats_are_exposed(tmp_path):
    """Like those of OpenEXR photos: the median is at half of white, whatever the unit of radiance."""
    for number in range(3):
        tifffile.imwrite(tmp_path / f"{number}.tif", np.full((20, 30, 3), 1e-3, np.float32), photometric="rgb")
    assert (gray_copy(find_photos(tmp_path)[0], Reduction.of(30, 20, 100)) == 124).all()


@pytest.mark.parametrize("suffix", [".tif", ".exr", pytest.param(".dng", marks=needs_rawpy)])
def test_gray_copies_of_an_object_on_black_show_the_object(tmp_path, monkeypatch, suffix):
    """An object of 40 % of the photo on a nearly black cloth. The photo is read strip by strip."""
    radiance = np.full((200, 120, 3), 0.0008, np.float32)
    radiance[40:160, 20:100] = 0.05
    radiance[40:160, 60:100] = 0.2
    path = tmp_path / f"a{suffix}"
    if suffix == ".dng":
        write_dng(path, np.round(WHITE * radiance))
    elif suffix == ".exr":
        OpenEXR.File({}, {"RGB": radiance.astype(np.float16)}).write(str(path))
    else:
        tifffile.imwrite(path, radiance, photometric="rgb")
    lengths = record_rows(monkeypatch)
    gray = gray_copy(Photo(path, 120, 200, None, ()), Reduction.of(120, 200, 200))
    assert 60 < np.median(gray[50:150, 30:50]) < np.median(gray[50:150, 70:90]) < 255
    assert gray[:30].max() < 40 and max(lengths) <= 64


def test_a_gray_copy_of_a_black_photo_is_black(tmp_path):
    tifffile.imwrite(tmp_path / "a.tif", np.zeros((20, 30, 3), np.float32), photometric="rgb")
    assert (gray_copy(Photo(tmp_path / "a.tif", 30, 20, None, ()), Reduction.of(30, 20, 100)) == 0).all()
