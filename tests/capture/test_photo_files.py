"""Photos in every format: the same linear radiance and sizes; files that cannot be read.

For colors: test_photo_colors. For memory: test_photo_memory.
"""

import struct
import zlib

import numpy as np
import pillow_heif
import pytest
import tifffile
from PIL import Image

from blender_nep.capture import load_capture
from blender_nep.capture.formats.photos import check_readable
from blender_nep.capture.photos.mask_files import MaskRaster
from blender_nep.capture.photos.photo_files import SUFFIXES, exif, image_size, open_image
from blender_nep.errors import CaptureError
from support.icc import SRGB, SRGB_CURVE, rgb_profile

MAKE, ORIENTATION = 0x010F, 0x0112
FLOAT32 = 2.4e-7
"""Two units in the last place of float32, relative"""


def linear(values):
    """IEC 61966-2-1, in double precision."""
    values = np.asarray(values, np.float64)
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def encoded(values):
    return np.where(values <= 0.0031308, 12.92 * values, 1.055 * np.maximum(values, 0) ** (1 / 2.4) - 0.055)


def pixels_of(dtype, channels, size=(37, 53)):
    """Random pixels over the whole range of the type."""
    rng = np.random.default_rng(channels)
    if np.dtype(dtype).kind == "f":
        pixels = rng.gamma(0.7, 1.5, (*size, channels)).astype(dtype)
        if channels in (2, 4):
            pixels[..., -1] = rng.uniform(0.3, 1, size)
        return pixels
    top = np.iinfo(dtype).max
    pixels = rng.integers(0, top, (*size, channels), dtype, endpoint=True)
    pixels[0, :2] = [[0] * channels, [top] * channels]
    return pixels


def smooth(size=(64, 96)):
    """A picture [H, W, 3] uint8 that lossy formats keep well: slow changes, all hues."""
    y, x = np.mgrid[: size[0], : size[1]]
    waves = [np.sin(x / 17 + k) + np.cos(y / 13 - 2 * k) for k in range(3)]
    return np.round(127.5 + 55 * np.stack(waves, -1)).astype(np.uint8)


def check(path, pixels, tolerance=FLOAT32):
    """The file gives the radiance of these stored pixels [H, W, C], floats as radiance, all others as sRGB; and its size."""
    color, alpha = open_image(path, "srgb").rows()
    top = 1 if pixels.dtype.kind == "f" else np.iinfo(pixels.dtype).max
    values = pixels.astype(np.float64) / top
    rgb = values[..., :3] if pixels.shape[-1] >= 3 else np.repeat(values[..., :1], 3, -1)
    np.testing.assert_allclose(color, rgb if top == 1 else linear(rgb), rtol=tolerance)
    assert color.dtype == np.float32 and image_size(path) == (pixels.shape[1], pixels.shape[0])
    assert (alpha is None) == (pixels.shape[-1] in (1, 3))
    if alpha is not None:
        np.testing.assert_allclose(alpha, values[..., -1], rtol=tolerance)


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
@pytest.mark.parametrize("dtype", ["u1", "u2", "f2", "f4"])
@pytest.mark.parametrize("how", [{}, {"compression": "lzw"}, {"compression": "zlib", "predictor": True}])
def test_tiff_gives_its_pixels(tmp_path, channels, dtype, how):
    pixels = pixels_of(dtype, channels)
    alpha = {"extrasamples": ["unassalpha"]} if channels in (2, 4) else {}
    photometric = "rgb" if channels > 2 else "minisblack"
    tifffile.imwrite(tmp_path / "a.tif", pixels if channels > 1 else pixels[..., 0], photometric=photometric, **alpha, **how)
    check(tmp_path / "a.tif", pixels)


@pytest.mark.parametrize(
    "how",
    [{"planarconfig": "separate"}, {"byteorder": ">"}, {"tile": (16, 16)}, {"bigtiff": True}, {"rowsperstrip": 5}],
    ids=lambda how: next(iter(how)),
)
def test_layouts_of_tiff(tmp_path, how):
    pixels = pixels_of(np.uint16, 3)
    given = np.moveaxis(pixels, -1, 0) if "planarconfig" in how else pixels
    tifffile.imwrite(tmp_path / "a.tiff", given, photometric="rgb", **how)
    check(tmp_path / "a.tiff", pixels)


@pytest.mark.parametrize("compression", [None, "tiff_lzw", "tiff_adobe_deflate", "packbits"])
@pytest.mark.parametrize("mode", ["L", "LA", "RGB", "RGBA", "I;16", "F"])
def test_tiff_files_of_pillow(tmp_path, mode, compression):
    dtype = {"I;16": np.uint16, "F": np.float32}.get(mode, np.uint8)
    pixels = pixels_of(dtype, len(mode) if dtype == np.uint8 else 1)
    image = Image.fromarray(pixels if pixels.shape[-1] > 1 else pixels[..., 0])
    assert image.mode == mode
    image.save(tmp_path / "a.tif", compression=compression)
    check(tmp_path / "a.tif", pixels)


def test_tiff_with_jpeg_inside(tmp_path):
    Image.fromarray(smooth()).save(tmp_path / "a.tif", compression="jpeg", quality=95)
    color, _ = open_image(tmp_path / "a.tif", "srgb").rows()
    assert np.abs(encoded(color) - smooth() / 255).mean() < 2 / 255


def test_other_depths_of_tiff(tmp_path):
    """Doubles, 32-bit and 12-bit numbers, black and white, white as 0, and a palette."""
    rng = np.random.default_rng(0)
    doubles = rng.uniform(0, 3, (9, 8, 3))
    tifffile.imwrite(tmp_path / "f8.tif", doubles, photometric="rgb")
    check(tmp_path / "f8.tif", doubles.astype(np.float32))
    whole = rng.integers(0, 1 << 32, (9, 8, 3), dtype=np.uint32)
    tifffile.imwrite(tmp_path / "u4.tif", whole, photometric="rgb")
    check(tmp_path / "u4.tif", (whole >> 16).astype(np.uint16))
    write_12_bits(tmp_path / "12.tif", whole >> 20)
    color, _ = open_image(tmp_path / "12.tif", "srgb").rows()
    np.testing.assert_allclose(color, linear((whole >> 20) / 4095), atol=2e-5)  # kept with 16 bits
    gray = rng.integers(0, 256, (9, 8), dtype=np.uint8)
    tifffile.imwrite(tmp_path / "white.tif", gray, photometric="miniswhite")
    check(tmp_path / "white.tif", 255 - gray[..., None])
    Image.fromarray(gray > 99).save(tmp_path / "bits.tif")
    check(tmp_path / "bits.tif", np.uint8(255) * (gray > 99)[..., None])
    few = Image.fromarray(smooth()).quantize(30)
    few.save(tmp_path / "palette.tif")
    check(tmp_path / "palette.tif", np.asarray(few.convert("RGB")))


def write_12_bits(path, pixels):
    """A TIFF file with 12 bits a channel [H, W, 3], byte by byte as TIFF 6.0 says; tifffile cannot write it."""
    bits = (pixels.reshape(-1, 1) >> np.arange(11, -1, -1)) & 1
    data = np.packbits(bits.astype(np.uint8).reshape(len(pixels), -1), axis=1).tobytes()
    height, width = pixels.shape[:2]
    fields = {256: width, 257: height, 258: 0, 259: 1, 262: 2, 273: 0, 277: 3, 278: height, 279: len(data)}
    fields[258], fields[273] = 8 + 2 + 12 * len(fields) + 4, 8 + 2 + 12 * len(fields) + 10
    entries = [struct.pack("<HHII", tag, 3 if tag == 258 else 4, 3 if tag == 258 else 1, v) for tag, v in fields.items()]
    head = b"II*\0" + struct.pack("<IH", 8, len(fields))
    path.write_bytes(head + b"".join(entries) + bytes(4) + struct.pack("<3H", 12, 12, 12) + data)


def test_the_alpha_of_tiff_is_what_its_tag_says(tmp_path):
    """Colors that are multiplied by alpha are divided by it, also whole numbers. Other samples are passed over."""
    straight = np.array([[[200, 100, 50, 255], [200, 100, 50, 128], [0, 0, 0, 0]]], np.uint8)
    multiplied = straight.copy()
    multiplied[0, 1, :3] = np.round(straight[0, 1, :3] * (128 / 255))
    for name, kind, pixels in (
        ("a", "assocalpha", multiplied),
        ("b", "unassalpha", straight),
        ("c", "unspecified", straight),
    ):
        tifffile.imwrite(tmp_path / f"{name}.tif", pixels, photometric="rgb", extrasamples=[kind])
        color, alpha = open_image(tmp_path / f"{name}.tif", "srgb").rows()
        np.testing.assert_allclose(color, linear(straight[..., :3] / 255), atol=0.009)  # a half step of 1 / 128
        assert (alpha is None) == (kind == "unspecified")
    radiance = np.array([[[2.0, 1.0, 0.5, 0.5]]], np.float32)
    tifffile.imwrite(tmp_path / "f.tif", radiance, photometric="rgb", extrasamples=["assocalpha"])
    np.testing.assert_allclose(open_image(tmp_path / "f.tif", "srgb").rows()[0], [[[4, 2, 1]]])


def test_the_first_page_of_a_tiff_counts(tmp_path):
    pages = [pixels_of(np.uint8, 3, size) for size in ((20, 30), (10, 15))]
    with tifffile.TiffWriter(tmp_path / "a.tif") as file:
        for page in pages:
            file.write(page, photometric="rgb")
    check(tmp_path / "a.tif", pages[0])


@pytest.mark.parametrize("mode", ["RGB", "RGBA"])
def test_webp_without_loss_gives_its_pixels(tmp_path, mode):
    pixels = pixels_of(np.uint8, len(mode))
    Image.fromarray(pixels).save(tmp_path / "a.webp", lossless=True, exact=True)
    check(tmp_path / "a.webp", pixels)


@pytest.mark.parametrize(
    ("name", "how"), [("a.webp", {"quality": 95}), ("a.jpg", {"quality": 95}), ("a.heic", {"quality": 95})]
)
def test_lossy_formats_are_near_their_pixels(tmp_path, name, how):
    """They store luma of 8 bits, WebP in 220 steps, and color at half the resolution: a few steps are lost."""
    image, path = Image.fromarray(smooth()), tmp_path / name
    pillow_heif.from_pillow(image).save(path, **how) if name.endswith("heic") else image.save(path, **how)
    color, _ = open_image(path, "srgb").rows()
    difference = np.abs(encoded(color) - smooth() / 255)
    assert difference.mean() < 2 / 255 and difference.max() < 8 / 255


@pytest.mark.parametrize(("mode", "bits"), [("RGB", 8), ("RGBA", 8), ("L", 8), ("RGB;16", 10), ("RGBA;16", 12)])
def test_heic_without_loss_gives_its_pixels(tmp_path, monkeypatch, mode, bits):
    """Only the rounding of red, green and blue to the YCbCr that HEVC stores is lost: at most 2 steps of its depth."""
    monkeypatch.setattr(pillow_heif.options, "SAVE_HDR_TO_12_BIT", bits == 12)
    channels = len(mode.partition(";")[0])
    pixels = pixels_of(np.uint16 if bits > 8 else np.uint8, channels, (64, 64))
    size = (64, 64)
    pillow_heif.from_bytes(mode, size, pixels.tobytes()).save(tmp_path / "a.heic", quality=-1, chroma=444)
    raster = open_image(tmp_path / "a.heic", "srgb")
    assert raster.stored.dtype == pixels.dtype and raster.stored.shape == pixels.shape
    color, alpha = raster.rows()
    top, step = np.iinfo(pixels.dtype).max, 1 / ((1 << bits) - 1)
    rgb = pixels[..., :3] if channels >= 3 else np.repeat(pixels, 3, -1)
    assert np.abs(encoded(color.astype(np.float64)) - rgb / top).max() < 2.5 * step
    if alpha is not None:
        np.testing.assert_allclose(alpha, pixels[..., -1] / top, atol=1.5 * step)


def test_linear_captures_ignore_what_files_say(tmp_path):
    pixels = pixels_of(np.uint8, 3)
    tifffile.imwrite(tmp_path / "a.tif", pixels, photometric="rgb")
    Image.fromarray(pixels).save(tmp_path / "a.webp", lossless=True)
    for name in ("a.tif", "a.webp"):
        np.testing.assert_allclose(open_image(tmp_path / name, "linear").rows()[0], pixels / 255.0, rtol=FLOAT32)


def test_gray_cmyk_bilevel_and_palette_files(tmp_path):
    image = Image.fromarray(smooth())
    gray = image.convert("L")
    gray.save(tmp_path / "gray.jpg", quality=100)
    color, alpha = open_image(tmp_path / "gray.jpg", "srgb").rows()
    assert alpha is None and np.abs(encoded(color) - np.asarray(gray)[..., None] / 255).max() < 2 / 255
    flat = Image.new("CMYK", (16, 16), (0, 128, 255, 51))
    flat.save(tmp_path / "cmyk.jpg", quality=100)
    inks = 1 - np.array([0, 128, 255]) / 255
    color, _ = open_image(tmp_path / "cmyk.jpg", "srgb").rows()
    np.testing.assert_allclose(encoded(color), np.broadcast_to(inks * (1 - 51 / 255), color.shape), atol=4 / 255)
    bits = np.asarray(gray) > 127
    Image.fromarray(bits).save(tmp_path / "bits.png")
    check(tmp_path / "bits.png", np.repeat(np.uint8(255) * bits[..., None], 3, -1))
    few = image.quantize(40)
    few.save(tmp_path / "palette.png")
    check(tmp_path / "palette.png", np.asarray(few.convert("RGB")))


@pytest.mark.parametrize("name", ["foto_Größe_写真.jpg", "写真.tif", "ü.heic", "é.webp", "a b " + "x" * 200 + ".png"])
def test_names_of_all_kinds(tmp_path, name):
    folder = tmp_path / ("Ordner mit Leerzeichen " + "y" * 150) / "日本"
    folder.mkdir(parents=True)
    write(folder / name)
    assert image_size(folder / name) == (96, 64) and open_image(folder / name, "srgb").size == (64, 96)


def write(path, **how):
    image = Image.fromarray(smooth())
    if path.suffix in (".heic", ".heif", ".hif"):
        pillow_heif.from_pillow(image).save(path, **how)
    elif path.suffix in (".tif", ".tiff"):
        tifffile.imwrite(path, smooth(), photometric="rgb", **how)
    else:
        image.save(path, **how)


@pytest.mark.parametrize("true", [".jpg", ".png", ".tif", ".webp", ".heic"])
@pytest.mark.parametrize("said", [".jpg", ".png", ".tif", ".webp", ".heic"])
def test_the_content_says_what_a_file_is(tmp_path, true, said):
    write(tmp_path / f"right{true}")
    (tmp_path / f"right{true}").rename(tmp_path / f"wrong{said}")
    color, _ = open_image(tmp_path / f"wrong{said}", "srgb").rows()
    assert np.abs(encoded(color) - smooth() / 255).mean() < 3 / 255


@pytest.mark.parametrize("suffix", [s for s in SUFFIXES if s not in (".exr", ".hif")])
def test_empty_and_torn_files_are_refused(tmp_path, suffix):
    """A file without content, of text, and files that end early: an error that names the file, and nothing else."""
    if suffix in SUFFIXES[SUFFIXES.index(".dng") :]:
        pytest.importorskip("rawpy")
    path = tmp_path / f"a{suffix}"
    for content in (b"", b"this is no photo\n" * 99):
        path.write_bytes(content)
        for read in (image_size, lambda file: open_image(file, "srgb"), exif):
            with pytest.raises(CaptureError, match=r"a\..* cannot be read as an image"):
                read(path)
    if suffix in SUFFIXES[SUFFIXES.index(".dng") :]:
        return
    write(path)
    whole = path.read_bytes()
    for share in (0.1, 0.5, 0.9):
        path.write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(CaptureError, match="cannot be read as an image"):
            open_image(path, "srgb")


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("suffix", [".jpg", ".png", ".tif", ".webp", ".heic"])
def test_damaged_files_are_read_or_refused(tmp_path, suffix):
    """Wrong bytes anywhere: no other error than the documented one. Some files are read, and some are refused."""
    path, rng, outcomes = tmp_path / f"a{suffix}", np.random.default_rng(0), set()
    tags = Image.Exif()
    tags[MAKE], tags[ORIENTATION] = "Camera", 6
    write(path, **({"compression": "lzw", "iccprofile": b"none" * 50} if suffix == ".tif" else {"exif": tags.tobytes()}))
    whole = path.read_bytes()
    for k in range(60):
        torn = bytearray(whole)
        for place in rng.integers(0, len(whole) if k % 2 else min(400, len(whole)), 4):
            torn[place] = rng.integers(256)
        path.write_bytes(bytes(torn))
        for read in (image_size, exif, lambda file: open_image(file, "srgb").rows(0, 2)):
            try:
                read(path)
                outcomes.add("read")
            except CaptureError:
                outcomes.add("refused")
    assert outcomes == {"read", "refused"}


def test_kinds_of_tiff_that_are_not_read_are_named(tmp_path):
    for how, words in (
        ({"photometric": "separated"}, "SEPARATED: save it as RGB"),
        ({"photometric": "cielab"}, "CIELAB: save it as RGB"),
    ):
        channels = 4 if how["photometric"] == "separated" else 3
        tifffile.imwrite(tmp_path / "a.tif", pixels_of(np.uint8, channels), **how)
        with pytest.raises(CaptureError, match=words):
            open_image(tmp_path / "a.tif", "srgb")
    tifffile.imwrite(tmp_path / "a.tif", np.zeros((5, 5), np.int16))
    with pytest.raises(CaptureError, match="without sign"):
        open_image(tmp_path / "a.tif", "srgb")


def test_the_message_about_other_files_lists_what_is_read(tmp_path):
    with pytest.raises(
        CaptureError, match=r"only exr, png, jpg, jpeg, tif, tiff, webp, heic, heif, hif, dng, .*, rw2 photos"
    ):
        check_readable(tmp_path / "a.psd", "a.psd")


@pytest.mark.parametrize("suffix", [".tif", ".webp", ".heic"])
def test_captures_of_new_formats_load(make_capture, suffix):
    tiny = make_capture(suffix=".png", masks=True)
    for frame in tiny.meta["frames"]:
        path = tiny.folder / frame["file_path"]
        with Image.open(path) as image:
            written = pillow_heif.from_pillow(image) if suffix == ".heic" else image
            written.save(path.with_suffix(suffix))
        path.unlink()
        frame["file_path"] = frame["file_path"].removesuffix(".png")
    capture = load_capture(tiny.save())
    assert capture.color_space == "srgb" and capture.views[0].image_path.suffix == suffix
    radiance, _ = capture.load_photo(0)
    np.testing.assert_allclose(radiance[12, 12], linear(102 / 255), atol=0.02)


@pytest.mark.parametrize("said", [None, "srgb"])
@pytest.mark.parametrize(
    ("kind", "profile", "space"),
    [("float32", False, "linear"), ("float16", False, "linear"), ("float32", True, "srgb"), ("uint16", False, "srgb")],
)
def test_a_capture_of_tiff_files_of_radiance_is_linear(make_capture, kind, profile, space, said):
    """A profile says how even floats are encoded, and it would not count if the capture were linear."""
    tiny = make_capture(suffix=".png")
    icc = rgb_profile(SRGB, SRGB_CURVE)
    extra = [(34675, 7, len(icc), icc, True)] if profile else []
    for frame in tiny.meta["frames"]:
        path = tiny.folder / frame["file_path"]
        with Image.open(path) as image:
            pixels = np.asarray(image.convert("RGB")) * (1 / 255 if kind[0] == "f" else 257)
        tifffile.imwrite(path.with_suffix(".tif"), pixels.astype(kind), photometric="rgb", extratags=extra)
        frame["file_path"] = frame["file_path"].replace(".png", ".tif")
    if said is not None:
        tiny.meta["color_space"] = said
    capture = load_capture(tiny.save())
    assert capture.color_space == space and not capture.warnings


@pytest.mark.parametrize("suffix", [".png", ".tif", ".webp"])
def test_masks_may_have_the_new_formats(tmp_path, suffix):
    coverage = pixels_of(np.uint8, 1)[..., 0]
    how = {"lossless": True} if suffix == ".webp" else {}
    Image.fromarray(coverage).save(tmp_path / f"mask{suffix}", **how)
    np.testing.assert_allclose(MaskRaster.of(tmp_path / f"mask{suffix}").rows(), coverage / 255.0, rtol=FLOAT32)


def test_an_interlaced_png_of_16_bits_of_gray_is_not_clipped(tmp_path):
    """Interlacing one pixel changes nothing, so the file is easily made."""

    def chunk(name: bytes, content: bytes) -> bytes:
        return len(content).to_bytes(4, "big") + name + content + zlib.crc32(name + content).to_bytes(4, "big")

    header = (1).to_bytes(4, "big") * 2 + bytes([16, 0, 0, 0, 1])
    pixel = zlib.compress(b"\0" + (30000).to_bytes(2, "big"))
    whole = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", pixel) + chunk(b"IEND", b"")
    (tmp_path / "a.png").write_bytes(whole)
    color, _ = open_image(tmp_path / "a.png", "linear").rows(0, 1)
    np.testing.assert_allclose(color, 30000 / 65535, atol=1e-5)
