"""Reads the width and height of an image from the header of its file. No bpy in this file.

Blender decodes all pixels before it gives an image's size. That takes 0.4 s for a photo of 24 megapixels, against 0.4 ms
here. The library uses the packages Pillow and OpenEXR (blender_nep/capture/photos/photo_files.py), which Blender's Python
lacks.
"""

import struct
import sys
from pathlib import Path

from ...plain_files import open_plain
from .formats import TiffHeader

JPEG_FRAMES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}  # start-of-frame markers (ITU T.81, table B.1)
HEADER_BYTES = 1 << 20
TIFF_STARTS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")


def image_size(path: Path) -> tuple[int, int]:
    """(width, height) of a PNG, JPEG, WebP, TIFF or OpenEXR file.

    Raises OSError where the file cannot be read or is none of these.
    """
    with open_plain(path, sys.maxsize) as file:
        data = file.read(HEADER_BYTES)
    try:
        if data[:8] == b"\x89PNG\r\n\x1a\n":
            return struct.unpack_from(">II", data, 16)
        if data[:4] == b"\x76\x2f\x31\x01":
            x0, y0, x1, y1 = struct.unpack_from("<4i", data, data.index(b"displayWindow\0box2i\0") + 24)
            return x1 - x0 + 1, y1 - y0 + 1
        if data[:2] == b"\xff\xd8":
            return _jpeg_size(path)
        if data[:4] == b"RIFF" and data[8:12] == b"WEBP":
            return _webp_size(data)
    except (struct.error, ValueError, IndexError) as error:
        raise OSError(f"the header of {path} is damaged") from error
    if data[:4] in TIFF_STARTS:
        return TiffHeader(path).size
    raise OSError(f"{path} is no PNG, JPEG, WebP, TIFF or OpenEXR file")


def _jpeg_size(path: Path) -> tuple[int, int]:
    """The size in the frame header. Phones may put megabytes before it, such as a depth map."""
    position = 2
    with open_plain(path, sys.maxsize) as file:
        while True:
            file.seek(position)
            segment = file.read(9)
            if segment[1] == 0xFF:  # a marker may have such bytes before it
                position += 1
                continue
            if segment[1] in JPEG_FRAMES:
                height, width = struct.unpack_from(">HH", segment, 5)
                return width, height
            position += 2 + struct.unpack_from(">H", segment, 2)[0]


def _webp_size(data: bytes) -> tuple[int, int]:
    """The size in the first part of a WebP file (RFC 9649): lossy, lossless, or extended."""
    kind = data[12:16]
    if kind == b"VP8 ":
        width, height = struct.unpack_from("<HH", data, 26)
        return width & 0x3FFF, height & 0x3FFF
    if kind == b"VP8L":
        (bits,) = struct.unpack_from("<I", data, 21)
        return (bits & 0x3FFF) + 1, (bits >> 14 & 0x3FFF) + 1
    if kind == b"VP8X" and len(data) >= 30:
        return int.from_bytes(data[24:27], "little") + 1, int.from_bytes(data[27:30], "little") + 1
    raise ValueError(kind)
