"""Reads PNG files with 16 bits a channel (PNG specification, W3C, sections 9 and 11). Pillow cuts them to 8 bits."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np

from blender_nep.capture.photos.formats.raster import check_values
from blender_nep.ops.compilation import kernel

_CHANNELS = {0: 1, 2: 3, 4: 2, 6: 4}
_SMALL_CHUNK = 64
_PIECE = 1 << 20
"""Bytes of a file that are inflated at a time"""


@kernel()
def _unfilter(rows: np.ndarray, kinds: np.ndarray, step: int) -> None:
    """Undo the five PNG scan-line filters in place; rows [h, bytes] uint8, `step` bytes a pixel."""
    for y in range(rows.shape[0]):
        kind = kinds[y]
        for i in range(rows.shape[1]):
            a = int(rows[y, i - step]) if i >= step else 0
            b = int(rows[y - 1, i]) if y > 0 else 0
            c = int(rows[y - 1, i - step]) if y > 0 and i >= step else 0
            guess = 0
            if kind == 1:
                guess = a
            elif kind == 2:
                guess = b
            elif kind == 3:
                guess = (a + b) // 2
            elif kind == 4:  # Paeth: the neighbor closest to a + b - c
                pa, pb, pc = abs(b - c), abs(a - c), abs(a + b - 2 * c)
                guess = a if pa <= pb and pa <= pc else (b if pb <= pc else c)
            rows[y, i] = (int(rows[y, i]) + guess) & 255


def header(path: Path) -> tuple[int, int, int, int, int]:
    """(width, height, bits a channel, color type, interlaced) of a PNG file. Raises ValueError for any other file."""
    with open(path, "rb") as file:
        start = file.read(29)
    if start[:8] != b"\x89PNG\r\n\x1a\n" or len(start) < 29 or start[12:16] != b"IHDR":
        raise ValueError("not a PNG file")
    width, height, bits, kind, _, _, interlaced = struct.unpack(">IIBBBBB", start[16:29])
    return width, height, bits, kind, interlaced


def chunks(path: Path) -> dict[bytes, bytes]:
    """{name: content} of the small chunks before a PNG's pixels, which say what its colors mean."""
    found = {}
    with open(path, "rb") as file:
        file.seek(8)
        while len(start := file.read(8)) == 8:
            size, name = struct.unpack(">I4s", start)
            if name in (b"IDAT", b"IEND"):
                break
            if size <= _SMALL_CHUNK:
                found[name] = file.read(size)
                file.seek(4, 1)
            else:
                file.seek(size + 4, 1)
    return found


def _inflated(path: Path, size: int) -> bytearray:
    """The scan lines of a PNG, `size` bytes as its header says. Not more is inflated, whatever the file holds.

    Raises ValueError if there are fewer or more.
    """
    inflater, raw = zlib.decompressobj(), bytearray()
    try:
        with open(path, "rb") as file:
            file.seek(8)
            while len(start := file.read(8)) == 8:
                length, name = struct.unpack(">I4s", start)
                if name == b"IEND":
                    break
                if name != b"IDAT":
                    file.seek(length + 4, 1)
                    continue
                while length > 0 and (packed := file.read(min(length, _PIECE))):
                    length -= len(packed)
                    while packed and not inflater.eof:
                        raw += inflater.decompress(packed, size + 1 - len(raw))
                        packed = inflater.unconsumed_tail
                        if len(raw) > size:
                            raise ValueError("more PNG data than its size needs")
                file.seek(length + 4, 1)
    except zlib.error as error:
        raise ValueError(f"damaged PNG data ({error})") from error
    if len(raw) < size:
        raise ValueError("truncated PNG data")
    return raw


def read_png16(path: Path) -> np.ndarray:
    """Read a non-interlaced 16-bit PNG: [H, W, C] uint16, C = 1 (gray), 2 (gray, alpha), 3 (RGB) or 4 (RGBA).

    Raises ValueError for another kind of PNG, or if the file is damaged.
    """
    width, height, bits, kind, interlaced = header(path)
    if bits != 16 or interlaced or kind not in _CHANNELS:
        raise ValueError("not a plain 16-bit PNG")
    check_values(width, height, _CHANNELS[kind])
    step = 2 * _CHANNELS[kind]
    raw = np.frombuffer(_inflated(path, height * (1 + step * width)), np.uint8).reshape(height, 1 + step * width)
    rows = np.ascontiguousarray(raw[:, 1:])
    _unfilter(rows, np.ascontiguousarray(raw[:, 0]), step)
    return rows.reshape(height, width, step).view(">u2").astype(np.uint16)
