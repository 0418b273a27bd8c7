"""EXIF data of a JPEG file, for the few tags that tell how the photo was taken."""

import struct
from fractions import Fraction

MAKER, MODEL = 0x010F, 0x0110
"""Names of the camera"""
EXPOSURE_TIME, F_NUMBER, ISO, TAKEN_AT, FILM_FOCAL_LENGTH = 0x829A, 0x829D, 0x8827, 0x9003, 0xA405
"""Seconds (Fraction), f-number (Fraction), ISO speed, time as "2026:05:02 10:05:00", focal length [mm] for 36 x 24 mm"""
_ASCII, _SHORT, _LONG, _RATIONAL = 2, 3, 4, 5
_SUB_DIRECTORY = 0x8769
_OF_IMAGES = (MAKER, MODEL)
"""These tags are in the directory of the image, all others in that of EXIF."""
_FIRST_PLACE = 8
"""Where the directory of the image begins, behind the TIFF header"""


def exif(tags: dict[int, int | Fraction | str]) -> bytes:
    """The JPEG segment with these EXIF tags. A whole number is below 65536, the parts of a fraction are below 2**32.

    A text has four characters or more. A shorter one would have to stand in its entry.
    """
    of_image = {tag: value for tag, value in tags.items() if tag in _OF_IMAGES}
    place = _FIRST_PLACE + len(_directory(of_image, 0, sub_directory=0))
    tiff = struct.pack("<2sHI", b"II", 42, _FIRST_PLACE) + _directory(of_image, _FIRST_PLACE, sub_directory=place)
    tiff += _directory({tag: value for tag, value in tags.items() if tag not in _OF_IMAGES}, place)
    body = b"Exif\0\0" + tiff
    return b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body


def _directory(tags: dict[int, int | Fraction | str], place: int, sub_directory: int | None = None) -> bytes:
    """A TIFF directory that begins at `place`, with the values that are too long for its entries behind it.

    `sub_directory`: where the directory of EXIF begins, to which this one points; None: to none.
    """
    count = len(tags) + (sub_directory is not None)
    far_place, entries, far = place + 2 + 12 * count + 4, b"", b""
    for tag, value in sorted(tags.items()):
        if isinstance(value, int):
            entries += struct.pack("<HHIHH", tag, _SHORT, 1, value, 0)
            continue
        if isinstance(value, Fraction):
            kind, length, data = _RATIONAL, 1, struct.pack("<II", value.numerator, value.denominator)
        else:
            data = value.encode("ascii") + b"\0"
            kind, length = _ASCII, len(data)
        entries += struct.pack("<HHII", tag, kind, length, far_place + len(far))
        far += data + b"\0" * (len(data) % 2)  # values begin at even places
    if sub_directory is not None:
        entries += struct.pack("<HHII", _SUB_DIRECTORY, _LONG, 1, sub_directory)
    return struct.pack("<H", count) + entries + struct.pack("<I", 0) + far
