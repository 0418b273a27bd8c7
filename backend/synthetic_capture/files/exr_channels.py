"""Reads and writes OpenEXR files with many named channels: the passes that Cycles renders, and the ground truth.

This is own code, because nothing in Blender's Python can do it (`scene_io/image_files.py` says what was tried). It knows
only files of the plain scan-line form, uncompressed or ZIP-compressed ("OpenEXR File Layout" of the Academy Software
Foundation). Cycles writes this form with the settings of `ground_truth.py`. The library reads and writes its OpenEXR files
with the package OpenEXR, which Blender's Python lacks.
"""

import struct
import zlib
from pathlib import Path

import numpy as np

from ...scene_io.image_files import write_whole

MAGIC = 20000630
NEITHER_TILED_NOR_DEEP_NOR_MULTIPART = 0x1A00  # these bits of the version must be 0
KINDS = {1: np.dtype("<f2"), 2: np.dtype("<f4")}
LINES_PER_BLOCK = {0: 1, 2: 1, 3: 16}  # for the compressions none, ZIPS and ZIP


def read_channels(path: Path) -> dict[str, np.ndarray]:
    """The channels {name: [H,W] float32} of an OpenEXR file.

    The file must be a single-part scan-line file, uncompressed or ZIP-compressed. Raises ValueError for other files.
    """
    data = Path(path).read_bytes()
    magic, version = struct.unpack_from("<ii", data)
    if magic != MAGIC or version & NEITHER_TILED_NOR_DEEP_NOR_MULTIPART:
        raise ValueError(f"{path}: not a single-part scan-line EXR file")
    header, position = _read_header(data, 8)
    compression = header["compression"][0]
    if compression not in LINES_PER_BLOCK:
        raise ValueError(f"{path}: EXR compression {compression} is not read here")
    x0, y0, x1, y1 = struct.unpack("<4i", header["dataWindow"])
    width, height = x1 - x0 + 1, y1 - y0 + 1
    channels = _channel_list(header["channels"])
    pixels = {name: np.empty((height, width), np.float32) for name, _ in channels}
    lines = LINES_PER_BLOCK[compression]
    blocks = -(-height // lines)
    for offset in struct.unpack_from(f"<{blocks}Q", data, position):
        top, size = struct.unpack_from("<ii", data, offset)
        top -= y0
        rows = min(lines, height - top)
        raw_size = rows * width * sum(kind.itemsize for _, kind in channels)
        block = data[offset + 8 : offset + 8 + size]
        if compression and size < raw_size:
            block = _undo_prediction(zlib.decompress(block))
        cursor = 0
        for row in range(top, top + rows):
            for name, kind in channels:
                pixels[name][row] = np.frombuffer(block, kind, width, cursor)
                cursor += width * kind.itemsize
    return pixels


def write_channels(path: Path, channels: dict[str, np.ndarray]) -> None:
    """Write the channels {name: [H,W] float16 or float32} as a ZIP-compressed OpenEXR file with one part.

    The file is written under a temporary name and then renamed. Raises OSError where it cannot be written.
    """
    names = sorted(channels)
    height, width = channels[names[0]].shape
    head = _header({name: channels[name].dtype for name in names}, width, height)
    lines, blocks = LINES_PER_BLOCK[3], []
    for top in range(0, height, lines):
        raw = b"".join(channels[name][row].tobytes() for row in range(top, min(top + lines, height)) for name in names)
        packed = zlib.compress(_predict(raw), 6)
        packed = packed if len(packed) < len(raw) else raw
        blocks.append(struct.pack("<ii", top, len(packed)) + packed)
    offsets = np.cumsum([len(head) + 8 * len(blocks)] + [len(block) for block in blocks[:-1]])
    write_whole(path, head + offsets.astype("<u8").tobytes() + b"".join(blocks))


def _header(kinds: dict[str, np.dtype], width: int, height: int) -> bytes:
    """The header of a ZIP-compressed file with the channels `kinds` {name: data type}."""
    numbers = {kind: number for number, kind in KINDS.items()}
    listed = b"".join(name.encode() + b"\0" + struct.pack("<iB3xii", numbers[kind], 0, 1, 1) for name, kind in kinds.items())
    box = struct.pack("<4i", 0, 0, width - 1, height - 1)
    attributes = (
        ("channels", "chlist", listed + b"\0"),
        ("compression", "compression", b"\3"),
        ("dataWindow", "box2i", box),
        ("displayWindow", "box2i", box),
        ("lineOrder", "lineOrder", b"\0"),
        ("pixelAspectRatio", "float", struct.pack("<f", 1)),
        ("screenWindowCenter", "v2f", struct.pack("<2f", 0, 0)),
        ("screenWindowWidth", "float", struct.pack("<f", 1)),
    )
    packed = (
        name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(value)) + value
        for name, kind, value in attributes
    )
    return struct.pack("<ii", MAGIC, 2) + b"".join(packed) + b"\0"


def _read_header(data: bytes, position: int) -> tuple[dict[str, bytes], int]:
    """Read the header that starts at `position`: ({name of an attribute: its value}, position after the header)."""
    header = {}
    while data[position]:
        end = data.index(b"\0", position)
        name, position = data[position:end].decode(), data.index(b"\0", end + 1) + 1
        (size,) = struct.unpack_from("<i", data, position)
        header[name] = data[position + 4 : position + 4 + size]
        position += 4 + size
    return header, position + 1


def _channel_list(value: bytes) -> list[tuple[str, np.dtype]]:
    channels, position = [], 0
    while value[position]:
        end = value.index(b"\0", position)
        (kind,) = struct.unpack_from("<i", value, end + 1)
        channels.append((value[position:end].decode(), KINDS[kind]))
        position = end + 17
    return channels


def _predict(raw: bytes) -> bytes:
    """Apply OpenEXR's ZIP filter.

    The filter puts the bytes at even positions first and the others after them. Then each byte becomes its difference from
    the byte before it, plus 128, modulo 256.
    """
    x = np.frombuffer(raw, np.uint8)
    x = np.concatenate([x[0::2], x[1::2]])
    return np.concatenate([x[:1], x[1:] - x[:-1] + np.uint8(128)]).tobytes()


def _undo_prediction(packed: bytes) -> bytes:
    """Undo what `_predict` does."""
    x = np.frombuffer(packed, np.uint8)
    x = np.cumsum(np.concatenate([x[:1], x[1:] - np.uint8(128)]), dtype=np.uint8)
    half = (len(x) + 1) // 2
    raw = np.empty(len(x), np.uint8)
    raw[0::2], raw[1::2] = x[:half], x[half:]
    return raw.tobytes()
