"""Image files as numpy arrays whose row 0 is the top row, without Blender's color management in between.

`read_exr`/`write_exr` know the plain scan-line form of OpenEXR (uncompressed or ZIP; "OpenEXR File Layout" of the
Academy Software Foundation) because Blender shows Python no pixels of a multilayer file's passes. Every other file is
read by Blender (`load_pixels`).
"""

import os
import struct
import zlib
from pathlib import Path

import bpy
import numpy as np

EXR_MAGIC = 20000630
EXR_TYPES = {1: np.dtype("<f2"), 2: np.dtype("<f4")}
EXR_LINES_PER_BLOCK = {0: 1, 2: 1, 3: 16}  # none, ZIPS, ZIP


def read_exr(path: Path) -> dict[str, np.ndarray]:
    """Channels {name: [H,W] float32} of a single-part scan-line EXR, uncompressed or ZIP; ValueError for others."""
    data = Path(path).read_bytes()
    magic, version = struct.unpack_from("<ii", data)
    if magic != EXR_MAGIC or version & 0x1A00:
        raise ValueError(f"{path}: not a single-part scan-line EXR file")
    header, position = _read_exr_header(data, 8)
    compression = header["compression"][0]
    if compression not in EXR_LINES_PER_BLOCK:
        raise ValueError(f"{path}: EXR compression {compression} is not read here")
    x0, y0, x1, y1 = struct.unpack("<4i", header["dataWindow"])
    width, height = x1 - x0 + 1, y1 - y0 + 1
    channels = _channel_list(header["channels"])
    pixels = {name: np.empty((height, width), np.float32) for name, _ in channels}
    lines = EXR_LINES_PER_BLOCK[compression]
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


def write_exr(path: Path, channels: dict[str, np.ndarray]) -> None:
    """Write {name: [H,W] float16 or float32} as one ZIP-compressed part; the file appears whole or not at all."""
    names = sorted(channels)
    height, width = channels[names[0]].shape
    kinds = {np.dtype(np.float16): 1, np.dtype(np.float32): 2}
    listed = (
        b"".join(name.encode() + b"\0" + struct.pack("<iB3xii", kinds[channels[name].dtype], 0, 1, 1) for name in names)
        + b"\0"
    )
    box = struct.pack("<4i", 0, 0, width - 1, height - 1)
    attributes = [
        ("channels", "chlist", listed),
        ("compression", "compression", b"\3"),
        ("dataWindow", "box2i", box),
        ("displayWindow", "box2i", box),
        ("lineOrder", "lineOrder", b"\0"),
        ("pixelAspectRatio", "float", struct.pack("<f", 1)),
        ("screenWindowCenter", "v2f", struct.pack("<2f", 0, 0)),
        ("screenWindowWidth", "float", struct.pack("<f", 1)),
    ]
    head = (
        struct.pack("<ii", EXR_MAGIC, 2)
        + b"".join(
            name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(value)) + value
            for name, kind, value in attributes
        )
        + b"\0"
    )
    blocks = []
    for top in range(0, height, 16):
        raw = b"".join(channels[name][row].tobytes() for row in range(top, min(top + 16, height)) for name in names)
        packed = zlib.compress(_predict(raw), 6)
        packed = packed if len(packed) < len(raw) else raw
        blocks.append(struct.pack("<ii", top, len(packed)) + packed)
    offsets = np.cumsum([len(head) + 8 * len(blocks)] + [len(block) for block in blocks[:-1]])
    write_whole(path, head + offsets.astype("<u8").tobytes() + b"".join(blocks))


def write_png(path: Path, pixels: np.ndarray) -> None:
    """Write [H,W] (grey) or [H,W,3] (RGB) uint8 as PNG, values untouched; the file appears whole or not at all."""
    height, width = pixels.shape[:2]
    rows = pixels.reshape(height, -1)
    raw = np.concatenate([np.zeros((height, 1), np.uint8), rows], axis=1).tobytes()

    def chunk(kind: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    header = struct.pack(">IIBBBBB", width, height, 8, 2 if pixels.ndim == 3 else 0, 0, 0, 0)
    write_whole(
        path, b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(raw, 9)) + chunk(b"IEND", b"")
    )


def load_pixels(path: Path) -> np.ndarray:
    """[H,W,4] float32 as stored (8-bit files: 0..1, still sRGB-encoded). OSError where Blender cannot read it."""
    try:
        image = bpy.data.images.load(str(path), check_existing=False)
    except RuntimeError as error:
        raise OSError(f"Blender cannot read the image {path}: {error}") from error
    try:
        image.colorspace_settings.is_data = True
        width, height = image.size
        if not width:
            raise OSError(f"Blender cannot read the image {path}")
        pixels = np.empty(width * height * 4, np.float32)
        image.pixels.foreach_get(pixels)
    finally:
        bpy.data.images.remove(image)
    return pixels.reshape(height, width, 4)[::-1]


def save_half_exr(path: Path, rgb: np.ndarray, scene) -> None:
    """Write [H,W,3] linear radiance as a DWAA-compressed half EXR (lossy, a fifth of ZIP's size) through Blender."""
    height, width = rgb.shape[:2]
    pixels = np.ones((height, width, 4), np.float32)
    pixels[..., :3] = rgb[::-1]
    image = bpy.data.images.new("nep.save", width, height, float_buffer=True, is_data=True)
    settings = scene.render.image_settings
    try:
        image.pixels.foreach_set(pixels.ravel())
        still_image(settings)
        settings.file_format, settings.color_mode, settings.color_depth = "OPEN_EXR", "RGB", "16"
        settings.exr_codec = "DWAA"
        image.save_render(str(path), scene=scene)
    finally:
        bpy.data.images.remove(image)


def still_image(settings, multilayer: bool = False) -> None:
    """Choose the media type where Blender has one (5.0 and later), before the file format is set."""
    if hasattr(settings, "media_type"):
        settings.media_type = "MULTI_LAYER_IMAGE" if multilayer else "IMAGE"


def write_whole(path: Path, data: bytes) -> None:
    """Write a file under a temporary name first: it appears whole or not at all."""
    path = Path(path)
    partial = path.with_name(path.name + ".partial")
    partial.write_bytes(data)
    os.replace(partial, path)


def _read_exr_header(data: bytes, position: int) -> tuple[dict[str, bytes], int]:
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
        channels.append((value[position:end].decode(), EXR_TYPES[kind]))
        position = end + 17
    return channels


def _predict(raw: bytes) -> bytes:
    """OpenEXR's ZIP filter: even bytes first, odd bytes after, then differences modulo 256 around 128."""
    x = np.frombuffer(raw, np.uint8)
    x = np.concatenate([x[0::2], x[1::2]])
    return np.concatenate([x[:1], x[1:] - x[:-1] + np.uint8(128)]).tobytes()


def _undo_prediction(packed: bytes) -> bytes:
    x = np.frombuffer(packed, np.uint8)
    x = np.cumsum(np.concatenate([x[:1], x[1:] - np.uint8(128)]), dtype=np.uint8)
    half = (len(x) + 1) // 2
    raw = np.empty(len(x), np.uint8)
    raw[0::2], raw[1::2] = x[:half], x[half:]
    return raw.tobytes()
