"""Reads PNG, JPEG and WebP files, with the colors that their tags say."""

from __future__ import annotations

import io
import struct
from pathlib import Path

import numpy as np
from PIL import ExifTags, Image, ImageCms

from blender_nep.capture.photos.formats import png16
from blender_nep.capture.photos.formats.color_encoding import (
    LINEAR,
    SRGB,
    ColorEncoding,
    adobe_rgb,
    from_codes,
    from_png_gamma,
)
from blender_nep.capture.photos.formats.icc_profiles import TableProfile, from_icc
from blender_nep.capture.photos.formats.raster import Raster
from blender_nep.safety.pictures import open_picture

_STRIP_ROWS = 64
"""Rows of an image that are taken from Pillow at once"""

DAMAGED_TAGS = (OSError, ValueError, SyntaxError, LookupError, TypeError, ArithmeticError, EOFError, struct.error)
"""What Pillow raises for damaged EXIF. The pixels may be sound all the same."""


def size(path: Path) -> tuple[int, int]:
    """(width, height)"""
    with open_picture(path) as image:
        return image.size


def tags(path: Path) -> dict[int, object]:
    """What EXIF says, {tag: value}. The orientation is not applied by `read`."""
    with open_picture(path) as image:
        # The method of PNG files decodes all pixels first, because EXIF may lie behind them. That is rare.
        exif = Image.Image.getexif(image)
        return {**exif, **exif.get_ifd(ExifTags.IFD.Exif)}


def read(path: Path, tagged: bool) -> Raster:
    """The pixels as stored: EXIF's orientation is not applied.

    Not `tagged`: the values count as linear, whatever the file says.
    """
    with open_picture(path) as image:
        if image.format == "PNG":
            _, _, bits, _, interlaced = png16.header(path)
            encoding = _png_encoding(png16.chunks(path), image) if tagged else LINEAR
            if bits == 16 and not interlaced:
                return Raster(png16.read_png16(path), _needs_no_tables(encoding))
        else:
            encoding = _encoding(image) if tagged else LINEAR
        if image.mode.startswith("I"):  # 16 bits of gray, which Pillow's own conversion clips at 255
            gray = np.asarray(image).clip(0, 65535).astype(np.uint16)
            return Raster(gray[..., None], encoding or SRGB)
        alpha = "A" in image.getbands() or "transparency" in image.info
        mode = "RGBA" if alpha else "RGB"
        if encoding is None:
            converted = _through_tables(image, mode)
            if converted is not None:
                return Raster(_pixels(converted), SRGB)
        return Raster(_pixels(image if image.mode == mode else image.convert(mode)), encoding or SRGB)


def _pixels(image: Image.Image) -> np.ndarray:
    """The pixels [H, W, C] uint8 of an image of C channels with 8 bits.

    They are taken in strips. `np.asarray` of the whole image would take their memory twice, and Pillow holds them as well.
    """
    width, height = image.size
    out = np.empty((height, width, len(image.getbands())), np.uint8)
    for start in range(0, height, _STRIP_ROWS):
        end = min(start + _STRIP_ROWS, height)
        out[start:end] = np.asarray(image.crop((0, start, width, end)))
    return out


def _encoding(image: Image.Image) -> ColorEncoding | None:
    """The encoding that an ICC profile or EXIF gives. None: the profile has tables."""
    profile = image.info.get("icc_profile")
    if profile:
        try:
            return from_icc(profile)
        except TableProfile:
            return None
    try:
        exif = image.getexif()
        space = exif.get_ifd(ExifTags.IFD.Exif).get(ExifTags.Base.ColorSpace)
        rule = str(exif.get_ifd(ExifTags.IFD.Interop).get(ExifTags.Interop.InteropIndex, "")) if space else ""
    except DAMAGED_TAGS:
        return SRGB
    # Cameras say Adobe RGB by the rule R03 and need no profile. Some say it by a color space 2, which EXIF does not know.
    return adobe_rgb() if space == 2 or rule.strip("\0 ") == "R03" else SRGB


def _png_encoding(chunks: dict[bytes, bytes], image: Image.Image) -> ColorEncoding | None:
    """The encoding that a PNG's chunks give, the surest first (PNG specification, third edition, section 4.3)."""
    if len(chunks.get(b"cICP", b"")) == 4:
        return from_codes(*chunks[b"cICP"][:2])
    if image.info.get("icc_profile"):
        return _encoding(image)
    if b"sRGB" in chunks:
        return SRGB
    gamma, places = chunks.get(b"gAMA", b""), chunks.get(b"cHRM", b"")
    return from_png_gamma(
        struct.unpack(">I", gamma)[0] / 1e5 if len(gamma) == 4 else None,
        tuple(x / 1e5 for x in struct.unpack(">8I", places)) if len(places) == 32 else None,
    )


def _needs_no_tables(encoding: ColorEncoding | None) -> ColorEncoding:
    if encoding is None:
        raise TableProfile("its color profile has tables instead of primaries: convert the photo to sRGB")
    return encoding


def _through_tables(image: Image.Image, mode: str) -> Image.Image | None:
    """The image in sRGB with 8 bits, by the tables of its profile; None if the profile does not fit the image."""
    with_color = image if image.mode in ("L", "RGB", "RGBA", "CMYK") else image.convert(mode)
    try:
        source = ImageCms.ImageCmsProfile(io.BytesIO(image.info["icc_profile"]))
        target, intent = ImageCms.createProfile("sRGB"), ImageCms.Intent.RELATIVE_COLORIMETRIC
        return ImageCms.profileToProfile(with_color, source, target, intent, mode)
    except (ImageCms.PyCMSError, OSError, ValueError):
        return None
