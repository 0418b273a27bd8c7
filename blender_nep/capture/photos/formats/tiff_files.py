"""Reads TIFF files: gray, RGB and RGBA with 8, 16 or 32 bits or floats. Of several pages, the first counts."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import tifffile
from PIL import ExifTags, Image

from blender_nep.capture.photos.formats.color_encoding import LINEAR, SRGB, ColorEncoding
from blender_nep.capture.photos.formats.icc_profiles import from_icc
from blender_nep.capture.photos.formats.pillow_files import DAMAGED_TAGS
from blender_nep.capture.photos.formats.raster import Raster, check_values

# tifffile tells of each odd tag, of which a damaged file has hundreds. What matters here is raised.
logging.getLogger("tifffile").setLevel(logging.CRITICAL)

_STARTS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_ICC_PROFILE = 34675
_WHITE_IS_0, _BLACK_IS_0, _RGB, _PALETTE, _YCBCR = 0, 1, 2, 3, 6
_JPEG = (6, 7, 34892, 33007)
"""Compressions by JPEG, whose decoder makes YCbCr to RGB"""
_COMPRESSIONS = (1, 5, 8, 32946, 32773, 34925, 50000, *_JPEG)
"""None, LZW, deflate (two numbers), PackBits, LZMA, Zstandard and JPEG. tifffile knows thirty more."""
_ASSOCIATED, _NOT_ASSOCIATED = 1, 2


def recognizes(start: bytes) -> bool:
    """Whether a file with these first 4 bytes or more is in this format."""
    return start[:4] in _STARTS


def size(path: Path) -> tuple[int, int]:
    """(width, height)"""
    with tifffile.TiffFile(path) as file:
        page = _first_page(file)
        return page.imagewidth, page.imagelength


def is_linear(path: Path) -> bool:
    """Whether the first page has floats and no profile."""
    with tifffile.TiffFile(path) as file:
        page = _first_page(file)
        return page.dtype is not None and page.dtype.kind == "f" and _ICC_PROFILE not in page.tags


def tags(path: Path) -> dict[int, object]:
    """The tags of the first page and of EXIF, {tag: value}. The orientation is not applied by `read`."""
    exif = Image.Exif()
    with open(path, "rb") as file:
        try:
            exif.load_from_fp(file)
            return {**exif, **exif.get_ifd(ExifTags.IFD.Exif)}
        except DAMAGED_TAGS:
            return {}


def read(path: Path, tagged: bool) -> Raster:
    """The first page, with its pixels as stored: the orientation is not applied.

    Not `tagged`: the values count as linear, whatever the file says. Floats without a profile are linear.
    """
    with tifffile.TiffFile(path) as file:
        page = _first_page(file)
        _check(page)
        pixels = _channels_last(page)
        profile = page.tags[_ICC_PROFILE].value if _ICC_PROFILE in page.tags else None
        pixels, associated = _without_other_samples(page, pixels)
        pixels = _whole_range(page, pixels)
    encoding: ColorEncoding = LINEAR
    if tagged:
        encoding = from_icc(bytes(profile)) if profile else LINEAR if pixels.dtype.kind == "f" else SRGB
    return Raster(pixels, encoding, associated)


def _first_page(file: tifffile.TiffFile) -> tifffile.TiffPage:
    page = file.pages[0]
    assert isinstance(page, tifffile.TiffPage), "the first page is read in full"
    return page


def _check(page: tifffile.TiffPage) -> None:
    """Raises ValueError if the colors of the page are of a kind that `read` does not know."""
    known = page.photometric in (_WHITE_IS_0, _BLACK_IS_0, _RGB, _PALETTE)
    if not known and not (page.photometric == _YCBCR and page.compression in _JPEG):
        name = getattr(page.photometric, "name", page.photometric)
        raise ValueError(f"its colors are {name}: save it as RGB")
    check_values(page.imagewidth, page.imagelength, page.samplesperpixel)
    if page.compression not in _COMPRESSIONS:
        name = getattr(page.compression, "name", page.compression)
        raise ValueError(f"its compression {name} is not supported: save it with LZW or deflate")
    if page.sampleformat not in (1, 3) or page.imagedepth != 1:
        raise ValueError("its values are neither whole numbers without sign nor floats")
    if not page.dataoffsets or 0 in page.databytecounts:  # tifffile would fill in zeros
        raise ValueError("parts of its pixels are missing")
    if max(o + n for o, n in zip(page.dataoffsets, page.databytecounts, strict=True)) > page.parent.filehandle.size:
        raise ValueError("the file is truncated")


def _channels_last(page: tifffile.TiffPage) -> np.ndarray:
    pixels = page.asarray()
    if page.axes == "YX":
        return pixels[..., None]
    if page.axes == "SYX":
        return np.moveaxis(pixels, 0, -1)
    if page.axes != "YXS":
        raise ValueError(f"its axes are {page.axes}")
    return pixels


def _without_other_samples(page: tifffile.TiffPage, pixels: np.ndarray) -> tuple[np.ndarray, bool]:
    """The color, and alpha if the page says that it has one; and whether the color is multiplied by alpha.

    A sample beyond the colors that the page does not call alpha is not used.
    """
    colors = 3 if page.photometric in (_RGB, _YCBCR) else 1
    if pixels.shape[-1] < colors:
        raise ValueError(f"it has {pixels.shape[-1]} of {colors} colors")
    kind = page.extrasamples[0] if page.extrasamples else 0
    alpha = kind in (_ASSOCIATED, _NOT_ASSOCIATED) and pixels.shape[-1] > colors
    return pixels[..., : colors + alpha], alpha and kind == _ASSOCIATED


def _whole_range(page: tifffile.TiffPage, pixels: np.ndarray) -> np.ndarray:
    """The pixels as uint8, uint16, float16 or float32, whose type's range is that of the page's values."""
    if page.photometric == _PALETTE:
        if page.colormap is None or page.colormap.shape[1] < 1 << page.bitspersample:
            raise ValueError("its palette is missing")
        # Writers extend bytes to 16 bits by 256 or by 257. Both have the byte above.
        return (page.colormap >> 8).astype(np.uint8).T[pixels[..., 0]]
    if pixels.dtype.kind == "f":
        return pixels if pixels.dtype.itemsize <= 4 else pixels.astype(np.float32)
    bits = page.bitspersample
    if bits == 32:
        pixels, bits = (pixels >> 16).astype(np.uint16), 16
    if bits not in (8, 16):
        if bits > 16:
            raise ValueError(f"it has {bits} bits a channel")
        top, kind = (1 << bits) - 1, np.uint8 if bits < 8 else np.uint16
        steps = np.round(np.arange(top + 1) * (np.iinfo(kind).max / top)).astype(kind)
        pixels = steps[pixels.astype(np.uint16)]
    return ~pixels if page.photometric == _WHITE_IS_0 else pixels
