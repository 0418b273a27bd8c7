"""EXIF data of a JPEG file, for the few tags that tell how the photo was taken."""

import struct
from fractions import Fraction

EXPOSURE_TIME, F_NUMBER, ISO, TAKEN_AT, FILM_FOCAL_LENGTH = 0x829A, 0x829D, 0x8827, 0x9003, 0xA405
"""Seconds (Fraction), f-number (Fraction), ISO speed, time as "2026:05:02 10:05:00", focal length [mm] for 36 x 24 mm"""
_SHORT, _ASCII, _RATIONAL = 3, 2, 5
_SUB_IFD, _SUB_IFD_PLACE = 0x8769, 26


def exif(tags: dict[int, int | Fraction | str]) -> bytes:
    """The JPEG segment with these EXIF tags. A whole number is below 65536, the parts of a fraction are below 2**32."""
    entries, far = b"", b""
    far_place = _SUB_IFD_PLACE + 2 + 12 * len(tags) + 4  # where the values lie that are too long for their entries
    for tag, value in sorted(tags.items()):
        if isinstance(value, int):
            entries += struct.pack("<HHIHH", tag, _SHORT, 1, value, 0)
            continue
        if isinstance(value, Fraction):
            kind, count, data = _RATIONAL, 1, struct.pack("<II", value.numerator, value.denominator)
        else:
            data = value.encode("ascii") + b"\0"
            kind, count = _ASCII, len(data)
        entries += struct.pack("<HHII", tag, kind, count, far_place + len(far))
        far += data
    pointer = struct.pack("<HHII", _SUB_IFD, 4, 1, _SUB_IFD_PLACE)
    tiff = struct.pack("<2sHI", b"II", 42, 8) + struct.pack("<H", 1) + pointer + struct.pack("<I", 0)
    body = b"Exif\0\0" + tiff + struct.pack("<H", len(tags)) + entries + struct.pack("<I", 0) + far
    return b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body
