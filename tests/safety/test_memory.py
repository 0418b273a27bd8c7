"""Small files that would fill the memory: what they say of their size is checked before their numbers are read.

All are read by one process. It tells the largest memory that it has had after each of them.
"""

from __future__ import annotations

import io
import json
import os
import re
import struct
import subprocess
import sys
import zipfile
import zlib
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from blender_nep.capture.formats.arrays import DAMAGED, read_npy, read_npz
from blender_nep.capture.photos.formats.png16 import read_png16
from blender_nep.capture.photos.photo_files import image_size, open_image
from support.batch_folder import write_batch, write_mirror_ball
from support.camera_exports import known_cameras, write_bundler, write_cameras_sphere, write_llff, write_metashape
from support.paths import ROOT

BOMB = 256 << 20
"""Bytes that a file holds and nobody asked for"""
LIMIT_MB = 150
"""Of memory that may be taken beside what the program has anyway"""

MEASURE = """
import resource, sys
from pathlib import Path
from blender_nep.capture.loading import describe
from blender_nep.capture.photos.photo_files import open_image
from blender_nep.errors import NepError
from blender_nep.gallery import write_gallery

def peak():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024

for name in ["small.exr", "small.png", "capture", *sys.argv[2:]]:
    path = Path(sys.argv[1], name)
    before = peak()
    try:
        if (path / "batch.json").is_file():
            write_gallery(path)
        elif path.is_dir():
            describe(path)
        else:
            open_image(path, "srgb")
        said = "read"
    except NepError as error:
        said = error.message
    print(name, peak() - before, said.replace(chr(10), " "))
"""


def chunk(name: bytes, content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + name + content + struct.pack(">I", zlib.crc32(name + content))


def write_png16(path: Path, width: int, height: int, packed: bytes, channels: int = 3) -> None:
    kind = {1: 0, 3: 2}[channels]
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 16, kind, 0, 0, 0))
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + header + chunk(b"IDAT", packed) + chunk(b"IEND", b""))


def packed_zeros(size: int) -> bytes:
    packing = zlib.compressobj(1)
    return b"".join(packing.compress(bytes(1 << 20)) for _ in range(size >> 20)) + packing.flush()


def write_exr(path: Path, stored: tuple[int, int], frame: tuple[int, int], corner: tuple[int, int] = (0, 0)) -> None:
    """Stored pixels [height, width] of 1 in the frame (width, height)."""
    low = np.array(corner, np.int32)
    windows = {
        "dataWindow": (low, low + np.array(stored[::-1], np.int32) - 1),
        "displayWindow": (np.zeros(2, np.int32), np.array(frame, np.int32) - 1),
    }
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage} | windows
    OpenEXR.File(header, {"RGB": np.ones((*stored, 3), np.float16)}).write(str(path))


def grow(path: Path, size: int = 5 << 30) -> None:
    """Let the file say that it is so large. On the disk it stays small."""
    os.truncate(path, size)


def npy_header(shape: tuple[int, ...]) -> bytes:
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f8", "fortran_order": False, "shape": shape})
    return header.getvalue()


def long_data(folder: Path) -> None:
    write_png16(folder / "file", 8, 8, packed_zeros(BOMB))
    (folder / "file").rename(folder / "a.png")


def large_frame(folder: Path) -> None:
    write_exr(folder / "a.exr", (64, 64), (16_000, 16_000))


def large_pixels(folder: Path) -> None:
    """The file says that it has 2 billion pixels. It stores 64."""
    write_exr(folder / "a.exr", (8, 8), (8, 8))
    content = (folder / "a.exr").read_bytes()
    at = content.index(b"dataWindow\0box2i\0") + len(b"dataWindow\0box2i\0") + 4
    (folder / "a.exr").write_bytes(content[:at] + struct.pack("<4i", 0, 0, 45_000, 45_000) + content[at + 16 :])


def large_llff(folder: Path) -> None:
    write_llff(folder / "capture", known_cameras())
    path = folder / "capture" / "poses_bounds.npy"
    path.write_bytes(npy_header((40_000_000, 17)))
    grow(path)


def few_kilobytes_of_matrices(folder: Path) -> None:
    write_cameras_sphere(folder / "capture", known_cameras(square=False))
    with zipfile.ZipFile(folder / "capture" / "cameras_sphere.npz", "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        with archive.open("world_mat_0.npy", "w") as member:
            member.write(npy_header((BOMB // 8,)))
            for _ in range(BOMB >> 20):
                member.write(bytes(1 << 20))


def long_header(folder: Path) -> None:
    """The header alone, which tells the shape, has hundreds of megabytes."""
    write_cameras_sphere(folder / "capture", known_cameras(square=False))
    with zipfile.ZipFile(folder / "capture" / "cameras_sphere.npz", "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        with archive.open("world_mat_0.npy", "w") as member:
            member.write(b"\x93NUMPY\2\0" + struct.pack("<I", BOMB))
            for _ in range(BOMB >> 20):
                member.write(b" " * (1 << 20))


def large_json(folder: Path) -> None:
    (folder / "capture" / "transforms.json").write_text(" ")
    grow(folder / "capture" / "transforms.json")


def large_xml(folder: Path) -> None:
    write_metashape(folder / "capture", known_cameras())
    grow(folder / "capture" / "cameras.xml")


def large_bundle(folder: Path) -> None:
    """A line that does not end."""
    write_bundler(folder / "capture", known_cameras(centered=True))
    (folder / "capture" / "bundle.out").write_text("# Bundle file v0.3\n4")
    grow(folder / "capture" / "bundle.out", 2 << 30)


def large_list(folder: Path) -> None:
    write_bundler(folder / "capture", known_cameras(centered=True))
    grow(folder / "capture" / "list.txt")


def large_colmap(folder: Path) -> None:
    for name in ("cameras.bin", "images.bin"):
        (folder / "capture" / name).write_bytes(struct.pack("<Q", 0))
    grow(folder / "capture" / "images.bin")


def shelf(folder: Path) -> None:
    write_mirror_ball(folder / "shelf" / "ball")
    write_batch(folder / "shelf", [{"name": "ball"}])


def large_preview(folder: Path) -> None:
    shelf(folder)
    Image.new("1", (16_000, 16_000)).save(folder / "shelf" / "ball" / "preview.png")


def large_light(folder: Path) -> None:
    shelf(folder)
    write_exr(folder / "shelf" / "ball" / "environment.exr", (3000, 6000), (6000, 3000))


def large_model(folder: Path) -> None:
    shelf(folder)
    grow(folder / "shelf" / "ball" / "asset.glb", 2 << 30)


def large_report(folder: Path) -> None:
    shelf(folder)
    grow(folder / "shelf" / "ball" / "report.json", 2 << 30)


def large_batch(folder: Path) -> None:
    shelf(folder)
    grow(folder / "shelf" / "batch.json", 2 << 30)


TRAPS = {
    long_data: "more PNG data than its size needs",
    large_frame: "its frame is 16000 x 16000",
    large_pixels: "its pixels are 45001 x 45001",
    large_llff: "poses_bounds.npy cannot be read",
    few_kilobytes_of_matrices: "cameras_sphere.npz cannot be read",
    long_header: "cameras_sphere.npz cannot be read",
    large_json: "it has more than 256 MB",
    large_xml: "it has more than 256 MB",
    large_bundle: "a line is too long",
    large_list: "it has more than 64 MB",
    large_colmap: "it has more than 2048 MB",
    large_preview: "read",
    large_light: "read",
    large_model: "read",
    large_report: "read",
    large_batch: "batch.json cannot be read",
}
"""{what makes a file: a part of what the program says of it}"""


@pytest.fixture(scope="module")
def told(tmp_path_factory) -> dict[str, tuple[int, str]]:
    """{name of a trap: the megabytes that it took, and what the program said}"""
    top = tmp_path_factory.mktemp("traps")
    write_exr(top / "small.exr", (8, 8), (8, 8))
    write_png16(top / "small.png", 8, 8, zlib.compress(bytes(8 * 49)))
    write_llff(top / "capture", known_cameras())
    paths = {}
    for trap in TRAPS:
        (top / trap.__name__ / "capture").mkdir(parents=True)
        trap(top / trap.__name__)
        found = next(path for name in ("a.*", "shelf", "capture") for path in (top / trap.__name__).glob(name))
        paths[trap.__name__] = str(found.relative_to(top))
    command = [sys.executable, "-c", MEASURE, str(top), *paths.values()]
    ended = subprocess.run(command, capture_output=True, text=True, cwd=ROOT, timeout=300)
    assert ended.returncode == 0, ended.stderr
    lines = dict(line.split(maxsplit=1) for line in ended.stdout.splitlines())
    return {name: (int((words := lines[path].split(maxsplit=1))[0]), words[1]) for name, path in paths.items()}


@pytest.mark.skipif(sys.platform != "linux", reason="a file may be larger than it is on the disk, and ru_maxrss is in kB")
@pytest.mark.parametrize("trap", TRAPS, ids=lambda trap: trap.__name__)
def test_a_small_file_takes_little_memory(trap, told):
    taken, said = told[trap.__name__]
    assert taken < LIMIT_MB and TRAPS[trap] in said, (taken, said)


# what is large for a reason


def test_a_photo_of_100_megapixels_is_read(tmp_path):
    width, height = 12_000, 8_400
    packing = zlib.compressobj(1)
    packed = packing.compress(bytes(height * (1 + 2 * width))) + packing.flush()
    write_png16(tmp_path / "a.png", width, height, packed, channels=1)
    assert image_size(tmp_path / "a.png") == (width, height)
    assert open_image(tmp_path / "a.png", "srgb").size == (height, width)


def test_an_exr_whose_frame_is_larger_than_its_pixels(tmp_path):
    """As Blender renders a part of the frame."""
    write_exr(tmp_path / "a.exr", (500, 400), (4000, 3000), corner=(1000, 2000))
    pixels = open_image(tmp_path / "a.exr", "srgb").stored
    assert pixels.shape == (3000, 4000, 3) and np.isfinite(pixels[2000:2500, 1000:1400]).all()
    assert np.isfinite(pixels[..., 0]).sum() == 500 * 400


def test_png_data_in_many_pieces_is_read(tmp_path):
    """Each program cuts them at other places."""
    pixels = np.random.default_rng(0).integers(0, 65536, (20, 30, 3), np.uint16)
    rows = np.concatenate([np.zeros((20, 1), np.uint8), pixels.astype(">u2").view(np.uint8).reshape(20, -1)], 1)
    packed = zlib.compress(rows.tobytes())
    header = chunk(b"IHDR", struct.pack(">IIBBBBB", 30, 20, 16, 2, 0, 0, 0))
    pieces = b"".join(chunk(b"IDAT", packed[at : at + 7]) for at in range(0, len(packed), 7))
    (tmp_path / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n" + header + pieces + chunk(b"tEXt", b"a\0b") + chunk(b"IEND", b""))
    np.testing.assert_array_equal(read_png16(tmp_path / "a.png"), pixels)


@pytest.mark.parametrize("kind", ["<f8", ">f4", "i4", "u1"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_arrays_are_read_as_numpy_reads_them(kind, order, tmp_path):
    values = np.asarray(np.arange(700).reshape(100, 7) % 200, kind, order=order)
    np.save(tmp_path / "a.npy", values)
    np.savez_compressed(tmp_path / "a.npz", one=values, two=values[:3], other=np.array(["text"]))
    np.testing.assert_array_equal(read_npy(tmp_path / "a.npy", lambda shape: True), values)
    found = read_npz(tmp_path / "a.npz", re.compile("one|two"), lambda shape: True)
    np.testing.assert_array_equal(found["one"], values)
    np.testing.assert_array_equal(found["two"], values[:3])
    assert set(found) == {"one", "two"} and found["one"].dtype == np.float64


@pytest.mark.parametrize("values", [np.array(["text"]), np.array([{}], object), np.ones(3, complex), np.array([True])])
def test_arrays_without_numbers_are_refused(values, tmp_path):
    np.save(tmp_path / "a.npy", values, allow_pickle=True)
    with pytest.raises(DAMAGED):
        read_npy(tmp_path / "a.npy", lambda shape: True)


@pytest.mark.parametrize("header", [b"(" * 16, b"{'descr': '<f8', 'shape': (9999999999999,)", b"\xff" * 9, b"[" * 3000])
def test_a_crafted_header_is_damage(header, tmp_path):
    """numpy reads it as Python's own syntax."""
    (tmp_path / "a.npy").write_bytes(b"\x93NUMPY\1\0" + struct.pack("<H", len(header)) + header)
    with pytest.raises(DAMAGED):
        read_npy(tmp_path / "a.npy", lambda shape: True)


def test_a_compression_without_a_limit_is_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_BZIP2) as archive:
        archive.writestr("one.npy", npy_header((1,)) + bytes(8))
    with pytest.raises(ValueError, match="compression"):
        read_npz(tmp_path / "a.npz", re.compile("one"), lambda shape: True)


def test_large_json_of_many_photos_is_read(tmp_path):
    """20,000 photos, the most that a capture may have, stay far below the limit of the file."""
    frame = {
        "file_path": "images/" + "x" * 60 + ".jpg",
        "transform_matrix": np.random.default_rng(0).random((4, 4)).tolist(),
    }
    assert 20_000 * len(json.dumps(frame)) < 100 << 20
