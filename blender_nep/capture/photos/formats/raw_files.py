"""Develops camera raw files into linear radiance by LibRaw. The package `rawpy` is optional."""

from __future__ import annotations

import io
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from PIL import ExifTags, Image

from blender_nep.capture.photos.formats.color_encoding import LINEAR
from blender_nep.capture.photos.formats.pillow_files import DAMAGED_TAGS
from blender_nep.capture.photos.formats.raster import Raster
from blender_nep.errors import CaptureError
from blender_nep.safety.pictures import open_picture
from blender_nep.safety.plain_files import read_bytes

SUFFIXES = (".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".orf", ".rw2")
_ORIENTATIONS = {0: 1, 3: 3, 5: 8, 6: 6}
"""{LibRaw's flip: EXIF's orientation}"""
_MOST_BYTES = 1 << 30
"""Of a raw file. In a larger one, no EXIF is searched."""
_FUJI = b"FUJIFILMCCD-RAW"
_CANON_TAGS, _CANON_EXIF = b"CMT1", b"CMT2"
_CANON_HEADER = 1 << 16


def size(path: Path) -> tuple[int, int]:
    """(width, height) of the image that `read` gives. Raises CaptureError without rawpy, as `tags` and `read` do."""
    with _opened(path) as (raw, _):
        return raw.sizes.width, raw.sizes.height


def read(path: Path) -> Raster:
    """The developed photo, as the sensor lies: it is not turned upright.

    Its white balance is the camera's. No brightness is adjusted to the photo's content, neither the exposure nor the white
    level, so that all photos of a capture are developed alike.
    """
    with _opened(path) as (raw, rawpy):
        pixels = raw.postprocess(
            use_camera_wb=True,
            no_auto_bright=True,
            adjust_maximum_thr=0.0,
            output_bps=16,
            gamma=(1, 1),
            output_color=rawpy.ColorSpace.sRGB,
            user_flip=0,
        )
    return Raster(pixels, LINEAR)


def tags(path: Path) -> dict[int, object]:
    """What EXIF says, {tag: value}, as far as it is found; the orientation is that which LibRaw finds."""
    with _opened(path) as (raw, _):
        orientation = _ORIENTATIONS.get(raw.sizes.flip, 1)
    found: dict[int, object] = {}
    try:
        for exif in _exif(read_bytes(path, _MOST_BYTES)):
            found |= {**exif, **exif.get_ifd(ExifTags.IFD.Exif)}
    except DAMAGED_TAGS:
        pass  # without it, the focal length is not known, and the photo can be used all the same
    return found | {ExifTags.Base.Orientation: orientation}


@contextmanager
def _opened(path: Path) -> Iterator[tuple[Any, Any]]:
    """The file opened by LibRaw, and the module rawpy. Raises CaptureError without rawpy, ValueError for a bad file."""
    try:
        import rawpy
    except ImportError as error:
        raise CaptureError(
            f"{path.name} is a camera raw file, and the package rawpy that reads it is not installed",
            "Install it (pip install 'blender-nep[raw]', or pip install rawpy), or develop the photos to 16-bit TIFF.",
        ) from error
    try:
        with rawpy.imread(str(path)) as raw:
            yield raw, rawpy
    except rawpy.LibRawError as error:
        words = error.args[0] if error.args else "damaged"
        raise ValueError(words.decode(errors="replace") if isinstance(words, bytes) else str(words)) from error


def _exif(data: bytes) -> Iterator[Image.Exif]:
    """The places in a raw file that hold EXIF, for the layouts of the endings in `SUFFIXES`."""
    if data.startswith(_FUJI):
        offset, length = struct.unpack_from(">II", data, 84)
        with open_picture(io.BytesIO(data[offset : offset + length]), ("JPEG",)) as preview:
            yield preview.getexif()
        return
    if data[4:12] == b"ftypcrx ":
        for name in (_CANON_TAGS, _CANON_EXIF):
            start = data.index(name, 0, _CANON_HEADER)
            (length,) = struct.unpack_from(">I", data, start - 4)
            yield _loaded(data[start + 4 : start - 4 + length])
        return
    # The other formats are TIFF, but Olympus and Panasonic have numbers of their own in place of TIFF's 42.
    yield _loaded((b"II*\0" if data[:2] == b"II" else b"MM\0*") + data[4:])


def _loaded(data: bytes) -> Image.Exif:
    exif = Image.Exif()
    exif.load_from_fp(io.BytesIO(data))
    return exif
