"""Photos with other primaries and curves give Rec.709 radiance, computed here from published matrices and curves."""

import io
import struct
import zlib
from fractions import Fraction
from functools import partial

import numpy as np
import OpenEXR
import pillow_heif
import pytest
import tifffile
from PIL import Image, ImageCms

from blender_nep.cameras.photo_folder import Photo, gray_copy
from blender_nep.cameras.reduction import Reduction
from blender_nep.capture.photos.formats.color_encoding import ColorEncoding
from blender_nep.capture.photos.photo_files import Raster, image_size, open_image
from blender_nep.errors import CaptureError
from support import icc


def matrix(text):
    return np.array([[float(Fraction(word)) for word in row.split()] for row in text.split(",")])


# CSS Color Module Level 4, section 20: linear light to CIE XYZ with the white D65, and from there to sRGB
P3_TO_XYZ = matrix(
    "608311/1250200 189793/714400 198249/1000160, 35783/156275 247089/357200 198249/2500400, 0 32229/714400 5220557/5000800"
)
ADOBE_TO_XYZ = matrix(
    "573536/994567 263643/1420810 187206/994567, 591459/1989134 6239551/9945670 374412/4972835, "
    "53769/1989134 351524/4972835 4929758/4972835"
)
BT2020_TO_XYZ = matrix(
    "63426534/99577255 20160776/139408157 47086771/278816314, 26158966/99577255 472592308/697040785 8267143/139408157, "
    "0 19567812/697040785 295819943/278816314"
)
XYZ_TO_SRGB = matrix(
    "12831/3959 -329/214 -1974/3959, -851781/878810 1648619/878810 36519/878810, 705/12673 -2585/12673 705/667"
)

PATCHES = np.array(
    [
        *([k, k, k] for k in (0, 9, 40, 118, 200, 255)),
        *(
            [255, 0, 0],
            [0, 255, 0],
            [0, 0, 255],
            [180, 60, 90],
            [90, 170, 60],
            [70, 90, 160],
            [230, 200, 40],
            [130, 120, 110],
        ),
        *([20, 10, 4], [255, 250, 240]),
    ],
    np.uint8,
)
SIDE = 16


def photo(patches=PATCHES):
    """A photo [64, 64, 3] of flat squares."""
    return np.repeat(np.repeat(patches.reshape(4, 4, 3), SIDE, 0), SIDE, 1)


def found(path, color_space="srgb"):
    """The radiance of the squares [16, 3], away from their edges."""
    color, _ = open_image(path, color_space).rows()
    return color.reshape(4, SIDE, 4, SIDE, 3)[:, 4:12, :, 4:12].mean((1, 3)).reshape(16, 3)


def srgb_curve(values):
    values = np.asarray(values, np.float64)
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def in_srgb(to_xyz, linear):
    return np.clip(linear @ (XYZ_TO_SRGB @ to_xyz).T, 0, 1)


P3_PROFILE = icc.rgb_profile(icc.DISPLAY_P3, icc.SRGB_CURVE)
ADOBE_PROFILE = icc.rgb_profile(icc.ADOBE_RGB, icc.gamma_curve(563 / 256))
CASES = {
    "Display P3": (P3_PROFILE, in_srgb(P3_TO_XYZ, srgb_curve(PATCHES / 255))),
    "Adobe RGB": (ADOBE_PROFILE, in_srgb(ADOBE_TO_XYZ, (PATCHES / 255) ** (563 / 256))),
}
ROUNDED = 4e-4
"""The colorants in these profiles are published with five digits, and their white is rounded to four."""


@pytest.mark.parametrize("gamut", CASES)
@pytest.mark.parametrize(
    ("name", "tolerance"),
    [("a.png", ROUNDED), ("8.tif", ROUNDED), ("16.tif", ROUNDED), ("a.webp", ROUNDED), ("a.jpg", 0.02), ("a.heic", 0.02)],
)
def test_profiles_are_followed_in_every_format(tmp_path, gamut, name, tolerance):
    """JPEG and HEIC round to YCbCr: a step of red there is up to 1.4 / 255, of linear light up to twice that, and times 1.4
    where Adobe's red becomes sRGB's."""
    profile, expected = CASES[gamut]
    write(tmp_path / name, profile)
    np.testing.assert_allclose(found(tmp_path / name), expected, atol=tolerance)


def write(path, profile):
    image = Image.fromarray(photo())
    if path.suffix == ".tif":
        pixels = photo() if path.stem == "8" else photo().astype(np.uint16) * 257
        tifffile.imwrite(path, pixels, photometric="rgb", iccprofile=profile)
    elif path.suffix == ".heic":
        image.info["icc_profile"] = profile
        pillow_heif.from_pillow(image).save(path, quality=-1, chroma=444)
    else:
        how = {".webp": {"lossless": True}, ".jpg": {"quality": 100, "subsampling": 0}}.get(path.suffix, {})
        image.save(path, icc_profile=profile, **how)


@pytest.mark.parametrize("gamut", CASES)
def test_the_color_management_of_others_agrees(tmp_path, gamut):
    """Little CMS, which the library does not use for such profiles, makes the same sRGB bytes."""
    image = Image.fromarray(photo())
    source, target = ImageCms.ImageCmsProfile(io.BytesIO(CASES[gamut][0])), ImageCms.createProfile("sRGB")
    intent = ImageCms.Intent.RELATIVE_COLORIMETRIC
    other = np.asarray(ImageCms.profileToProfile(image, source, target, intent))[8::SIDE, 8::SIDE].reshape(16, 3)
    write(tmp_path / "a.png", CASES[gamut][0])
    linear = found(tmp_path / "a.png")
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    assert np.abs(255 * encoded - other).max() < 1.1


def test_floats_with_a_profile_keep_colors_outside_of_rec709(tmp_path):
    values = np.array([[[0.0, 1.0, 0.0], [4.0, 2.0, 1.0]]], np.float32)
    profile = icc.rgb_profile(icc.DISPLAY_P3, icc.gamma_curve(1.0))
    tifffile.imwrite(tmp_path / "a.tif", values, photometric="rgb", iccprofile=profile)
    expected = values @ (XYZ_TO_SRGB @ P3_TO_XYZ).T
    color, _ = open_image(tmp_path / "a.tif", "srgb").rows()
    assert expected.min() < -0.2
    np.testing.assert_allclose(color, expected, atol=5 * ROUNDED)
    np.testing.assert_array_equal(open_image(tmp_path / "a.tif", "linear").rows()[0], values)


STEPS = np.linspace(0, 1, 1024)
CURVES = {
    "gamma": (icc.gamma_curve(1.8), lambda x: x ** (461 / 256)),
    "linear": (b"curv" + bytes(8), lambda x: x),
    "table": (icc.table_curve(STEPS**3), lambda x: x**3),
    "formula 0": (icc.parametric_curve(0, 1.8), lambda x: x**1.8),
    "formula 1": (icc.parametric_curve(1, 2.0, 1.25, -0.25), lambda x: np.where(x > 0.2, 1.25 * x - 0.25, 0) ** 2),
    "formula 2": (
        icc.parametric_curve(2, 2.0, 1.125, -0.225, 0.19),
        lambda x: np.where(x > 0.2, 1.125 * x - 0.225, 0) ** 2 + 0.19,
    ),
    "formula 4": (
        icc.parametric_curve(4, 2.0, 0.9, 0.0, 0.5, 0.25, 0.19, 0.05),
        lambda x: np.where(x >= 0.25, (0.9 * x) ** 2 + 0.19, 0.5 * x + 0.05),
    ),
}


@pytest.mark.parametrize("kind", CURVES)
def test_all_kinds_of_curves(tmp_path, kind):
    curve, expected = CURVES[kind]
    write(tmp_path / "a.png", icc.rgb_profile(icc.SRGB, curve))
    write(tmp_path / "16.tif", icc.rgb_profile(icc.SRGB, curve))
    for name in ("a.png", "16.tif"):
        np.testing.assert_allclose(found(tmp_path / name), expected(PATCHES / 255), atol=3e-5)


def test_each_channel_may_have_a_curve_and_gray_one(tmp_path):
    write(tmp_path / "a.png", icc.rgb_profile(icc.SRGB, *(icc.gamma_curve(g) for g in (1.5, 2.0, 2.5))))
    np.testing.assert_allclose(found(tmp_path / "a.png"), (PATCHES / 255) ** [1.5, 2.0, 2.5], atol=1e-5)
    gray = np.arange(256, dtype=np.uint8).reshape(16, 16)
    profile = icc.profile(b"GRAY", b"XYZ ", {"kTRC": icc.gamma_curve(2.0)})
    Image.fromarray(gray).save(tmp_path / "g.png", icc_profile=profile)
    color, _ = open_image(tmp_path / "g.png", "srgb").rows()
    np.testing.assert_allclose(color, np.repeat((gray[..., None] / 255.0) ** 2, 3, -1), atol=1e-6)


@pytest.mark.parametrize("suffix", ["png", "jpg", "tif", "webp"])
def test_profiles_of_srgb_change_no_bit(tmp_path, suffix):
    """Of Little CMS, with rounded colorants, and with a curve as a table: the values are those without a profile."""
    profiles = [
        ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes(),
        icc.rgb_profile(icc.SRGB, icc.SRGB_CURVE),
        icc.rgb_profile(icc.SRGB, icc.table_curve(srgb_curve(STEPS))),
        b"damaged",
        icc.rgb_profile(icc.DISPLAY_P3, icc.parametric_curve(0, -3.0)),
        P3_PROFILE[:200],
    ]
    image = Image.fromarray(np.random.default_rng(0).integers(0, 256, (20, 30, 3), dtype=np.uint8))
    image.save(tmp_path / f"plain.{suffix}")
    plain, _ = open_image(tmp_path / f"plain.{suffix}", "srgb").rows()
    for number, profile in enumerate(profiles):
        image.save(tmp_path / f"{number}.{suffix}", icc_profile=profile)
        np.testing.assert_array_equal(open_image(tmp_path / f"{number}.{suffix}", "srgb").rows()[0], plain)


def test_a_profile_with_tables_is_followed_for_8_bits_only(tmp_path):
    profile = icc.ink_profile()
    black = np.linspace(0, 255, 16).round().astype(np.uint8).reshape(4, 4)
    inks = np.zeros((64, 64, 4), np.uint8)
    inks[..., 3] = np.repeat(np.repeat(black, SIDE, 0), SIDE, 1)
    Image.fromarray(inks, "CMYK").save(tmp_path / "a.jpg", quality=100, icc_profile=profile)
    lightness = 100 * (1 - black.ravel() / 255)
    expected = np.where(lightness > 8, ((lightness + 16) / 116) ** 3, lightness / 903.3)  # CIE 1976
    np.testing.assert_allclose(found(tmp_path / "a.jpg"), np.repeat(expected[:, None], 3, 1), atol=0.015)
    pixels = np.zeros((5, 5, 3), np.uint16)
    tifffile.imwrite(tmp_path / "a.tif", pixels, photometric="rgb", iccprofile=profile)
    with pytest.raises(CaptureError, match="convert the photo to sRGB"):
        open_image(tmp_path / "a.tif", "srgb")
    # a printer's profile does not fit RGB pixels: it says nothing
    Image.fromarray(photo()).save(tmp_path / "a.png", icc_profile=profile)
    np.testing.assert_allclose(found(tmp_path / "a.png"), srgb_curve(PATCHES / 255), atol=1e-6)


@pytest.mark.parametrize(("size", "read"), [((16320, 12240), True), ((32768, 32768), False)])
def test_photos_of_200_megapixels_are_no_bombs(tmp_path, recwarn, size, read):
    """A file's header is enough for this. The largest cameras of phones have 200 megapixels."""
    with_chunks(tmp_path / "a.png", {})
    content = bytearray((tmp_path / "a.png").read_bytes())
    content[16:24] = struct.pack(">II", *size)
    content[29:33] = struct.pack(">I", zlib.crc32(content[12:29]))
    (tmp_path / "a.png").write_bytes(content)
    if read:
        assert image_size(tmp_path / "a.png") == size and not recwarn
    else:
        with pytest.raises(CaptureError, match="decompression bomb"):
            image_size(tmp_path / "a.png")


def with_chunks(path, chunks, bits=8):
    """Write the squares as PNG with these chunks before its pixels."""

    def chunk(name, data):
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    pixels = photo() if bits == 8 else (photo().astype(">u2") * 257).astype(">u2")
    rows = b"".join(b"\0" + row.tobytes() for row in pixels)
    head = chunk(b"IHDR", struct.pack(">IIBBBBB", 64, 64, bits, 2, 0, 0, 0))
    body = b"".join(chunk(name, data) for name, data in chunks.items())
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + head + body + chunk(b"IDAT", zlib.compress(rows)) + chunk(b"IEND", b""))


def gamma(value):
    return {b"gAMA": struct.pack(">I", round(1e5 * value))}


def places(*numbers):
    return {b"cHRM": struct.pack(">8I", *(round(1e5 * x) for x in numbers))}


SRGB_PLACES = places(0.3127, 0.329, 0.64, 0.33, 0.3, 0.6, 0.15, 0.06)
P3_PLACES = places(0.3127, 0.329, 0.68, 0.32, 0.265, 0.69, 0.15, 0.06)
ADOBE_PLACES = places(0.3127, 0.329, 0.64, 0.33, 0.21, 0.71, 0.15, 0.06)
PLAIN = srgb_curve(PATCHES / 255)


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize(
    ("chunks", "expected"),
    [
        ({b"sRGB": b"\0"}, PLAIN),
        (gamma(0.45455), PLAIN),
        (gamma(0.45455) | SRGB_PLACES, PLAIN),
        (gamma(1.0), PATCHES / 255),
        (gamma(0.5), (PATCHES / 255) ** 2),
        (gamma(0.45455) | P3_PLACES, in_srgb(P3_TO_XYZ, PLAIN)),
        (gamma(256 / 563) | ADOBE_PLACES, in_srgb(ADOBE_TO_XYZ, PLAIN)),
        ({b"sRGB": b"\0"} | gamma(1.0) | P3_PLACES, PLAIN),
        ({b"cICP": bytes([1, 13, 0, 1])}, PLAIN),
        ({b"cICP": bytes([12, 13, 0, 1])}, in_srgb(P3_TO_XYZ, PLAIN)),
        ({b"cICP": bytes([9, 8, 0, 1])}, in_srgb(BT2020_TO_XYZ, PATCHES / 255)),
        ({b"cICP": bytes([1, 8, 0, 1])} | {b"sRGB": b"\0"}, PATCHES / 255),
        ({b"iCCP": b"P3\0\0" + zlib.compress(P3_PROFILE)} | {b"sRGB": b"\0"}, in_srgb(P3_TO_XYZ, PLAIN)),
        (gamma(0.0) | places(*[0.0] * 8), PLAIN),
        (places(0.3127, 0.329, 0.6, 0.3, 0.6, 0.3, 0.6, 0.3), PLAIN),
    ],
)
def test_chunks_of_png(tmp_path, chunks, expected, bits):
    with_chunks(tmp_path / "a.png", chunks, bits)
    np.testing.assert_allclose(found(tmp_path / "a.png"), expected, atol=ROUNDED if b"iCCP" in chunks else 2e-6)
    np.testing.assert_allclose(found(tmp_path / "a.png", "linear"), PATCHES / 255, atol=1e-6)


def test_hdr_curves_are_refused(tmp_path):
    with_chunks(tmp_path / "a.png", {b"cICP": bytes([9, 16, 0, 1])})
    with pytest.raises(CaptureError, match="HDR"):
        open_image(tmp_path / "a.png", "srgb")


@pytest.mark.parametrize(
    ("primaries", "transfer", "expected"),
    [
        (12, 13, in_srgb(P3_TO_XYZ, PLAIN)),
        (1, 13, PLAIN),
        (2, 2, PLAIN),
        (1, 4, (PATCHES / 255) ** 2.2),
        (1, 1, np.where(PATCHES < 0.081 * 255, PATCHES / 255 / 4.5, ((PATCHES / 255 + 0.099) / 1.099) ** (1 / 0.45))),
    ],
)
def test_codes_of_heif(tmp_path, primaries, transfer, expected):
    written = pillow_heif.from_pillow(Image.fromarray(photo()))
    codes = {"color_primaries": primaries, "transfer_characteristics": transfer}
    written.save(tmp_path / "a.heic", quality=-1, chroma=444, **codes)
    np.testing.assert_allclose(found(tmp_path / "a.heic"), expected, atol=0.015)


@pytest.mark.parametrize("rule", ["R03", "R98", None])
def test_cameras_say_adobe_rgb_in_exif(tmp_path, rule):
    tags = Image.Exif()
    more = tags.get_ifd(0x8769)
    more[0xA001] = 65535 if rule == "R03" else 1
    if rule:
        more[0xA005] = {1: rule}
    Image.fromarray(photo()).save(tmp_path / "a.jpg", quality=100, subsampling=0, exif=tags)
    expected = CASES["Adobe RGB"][1] if rule == "R03" else PLAIN
    np.testing.assert_allclose(found(tmp_path / "a.jpg"), expected, atol=0.02)


REC2020 = (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, 0.3127, 0.3290)
ACESCG_TO_REC709 = np.array([[1.70505, -0.62179, -0.08326], [-0.13026, 1.14080, -0.01055], [-0.02400, -0.12897, 1.15297]])
"""The usual matrix: ACES's AP1 with its white near D60, adapted to D65 by Bradford"""


@pytest.mark.parametrize(
    ("places", "to_rec709", "tolerance"),
    [
        (REC2020, XYZ_TO_SRGB @ BT2020_TO_XYZ, 1e-3),
        ((0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767), ACESCG_TO_REC709, 1e-3),
        ((0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290), np.eye(3), 0),
        ((0.64, 0.33, 0.64, 0.33, 0.64, 0.33, 0.3127, 0.3290), np.eye(3), 0),
        ((0.0,) * 8, np.eye(3), 0),
        ((float("nan"),) * 8, np.eye(3), 0),
    ],
    ids=["Rec.2020", "ACEScg", "Rec.709", "on a line", "zeros", "nan"],
)
def test_the_chromaticities_of_openexr_count(tmp_path, places, to_rec709, tolerance):
    """Nothing is cut: radiance may be larger than 1, or negative. Damaged chromaticities count as none."""
    radiance = np.random.default_rng(0).uniform(0, 3, (4, 5, 3)).astype(np.float32)
    OpenEXR.File({"chromaticities": places}, {"RGB": radiance}).write(str(tmp_path / "a.exr"))
    for color_space in ("srgb", "linear"):
        color, _ = open_image(tmp_path / "a.exr", color_space).rows()
        np.testing.assert_allclose(color, radiance @ to_rec709.T, atol=tolerance, rtol=tolerance)


def test_a_gray_copy_of_an_exr_with_chromaticities_is_exposed(tmp_path):
    radiance = np.full((20, 30, 3), 1e-3, np.float32)
    OpenEXR.File({"chromaticities": REC2020}, {"RGB": radiance}).write(str(tmp_path / "a.exr"))
    gray = gray_copy(Photo(tmp_path / "a.exr", 30, 20, None, ()), Reduction.of(30, 20, 100))
    assert (gray == 124).all()


@pytest.mark.parametrize("curves", [1, 3])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_whole_numbers_are_looked_up_as_the_curve_gives_them(dtype, curves):
    """The curve is asked once for each value that the type has, not for each pixel."""
    asked = []

    def curve(power, x):
        asked.append(x.size)
        return (x**power).astype(np.float32)

    powers, top = [2.2, 2.4, 1.8][:curves], np.iinfo(dtype).max
    encoding = ColorEncoding(tuple(partial(curve, power) for power in powers))
    pixels = np.random.default_rng(0).integers(0, top, (200, 300, 3), dtype, endpoint=True)
    raster = Raster(pixels, encoding)
    color = np.concatenate([raster.rows(start, start + 50)[0] for start in range(0, 200, 50)])
    assert asked == [top + 1] * curves
    exact = [curve(power, pixels[..., i] / float(top)) for i, power in enumerate(powers * (4 - curves))][:3]
    np.testing.assert_array_equal(color, np.stack(exact, -1))


def test_a_clipped_channel_remains_recognizable(tmp_path):
    """Integer files give no more than 1, and a channel that is full in wider primaries gives 1 in Rec.709, too."""
    for profile in (P3_PROFILE, ADOBE_PROFILE):
        write(tmp_path / "a.png", profile)
        color = found(tmp_path / "a.png")
        assert color.min() >= 0 and color.max() <= 1 and (color[PATCHES == 255] > 0.999).all()
