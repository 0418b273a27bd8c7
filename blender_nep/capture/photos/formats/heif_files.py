"""Reads HEIC and HEIF files, with 8, 10 or 12 bits a channel.

A HEIF file says how its coded image is to be turned, mirrored and cropped, and libheif does all of that: no common reader
gives the pixels without it. So these are the stored pixels of this format. EXIF in the file may repeat the turn (phones
write both); the standard says that it must not be applied again, and `tags` leaves it out.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pillow_heif
from PIL import ExifTags, Image

from blender_nep.capture.photos.formats.color_encoding import LINEAR, SRGB, ColorEncoding, from_codes
from blender_nep.capture.photos.formats.icc_profiles import from_icc
from blender_nep.capture.photos.formats.raster import Raster, check_values

_BRANDS = (b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"hevm", b"hevs", b"mif1", b"msf1")


def recognizes(start: bytes) -> bool:
    """Whether a file with these first 12 bytes is in this format."""
    return start[4:8] == b"ftyp" and start[8:12] in _BRANDS


def size(path: Path) -> tuple[int, int]:
    """(width, height) of the image that `read` gives."""
    return _open(path).size


def tags(path: Path) -> dict[int, object]:
    """What EXIF says, {tag: value}, without the orientation: the pixels that `read` gives are turned already."""
    data = _open(path).info.get("exif")
    if not data:
        return {}
    exif = Image.Exif()
    exif.load(data)
    found: dict[int, object] = {**exif, **exif.get_ifd(ExifTags.IFD.Exif)}
    found.pop(ExifTags.Base.Orientation, None)
    return found


def read(path: Path, tagged: bool) -> Raster:
    """The primary image. Not `tagged`: the values count as linear, whatever the file says."""
    file = _open(path)
    kind, _, bits = file.mode.partition(";")
    width, height = file.size
    check_values(width, height, len(kind))
    encoding = _encoding(file.info) if tagged else LINEAR
    pixels = np.asarray(file)
    pixels = pixels[..., None] if pixels.ndim == 2 else pixels
    if bits and int(bits) < 16:
        top = (1 << int(bits)) - 1
        pixels = np.round(np.arange(top + 1) * (65535 / top)).astype(np.uint16)[np.minimum(pixels, top)]
    return Raster(pixels, encoding, associated=kind.endswith("a"))


def _open(path: Path) -> pillow_heif.HeifFile:
    return pillow_heif.open_heif(path, convert_hdr_to_8bit=False, hdr_to_16bit=False)


def _encoding(info: dict) -> ColorEncoding:
    if info.get("icc_profile"):
        return from_icc(info["icc_profile"])
    codes = info.get("nclx_profile")
    return from_codes(codes["color_primaries"], codes["transfer_characteristics"]) if codes else SRGB
