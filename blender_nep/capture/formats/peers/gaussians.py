"""Reads `cameras.json`, which 3D Gaussian splatting writes beside its result.

An entry has the photo's name, mostly without its ending, its size, focal lengths in pixels, the position, and the rotation
from the camera to the world, row after row. The camera's axes are OpenCV's, and the principal point is the photo's middle.
"""

from __future__ import annotations

from pathlib import Path

from blender_nep.capture.description import CaptureDescription
from blender_nep.capture.formats.peers.assembly import (
    AGAIN,
    Intrinsics,
    PeerCamera,
    described,
    files_with,
    fixed,
    json_of,
    member,
    number,
    numbers,
)
from blender_nep.errors import CaptureError


def recognizes(folder: Path) -> bool:
    """Whether the folder holds such a file."""
    return bool(_files(folder))


def _files(folder: Path) -> list[Path]:
    return files_with(folder, ("cameras.json",), b'"img_name"')


def read(folder: Path) -> CaptureDescription:
    """What the file says; photos are opened only for their size. Raises CaptureError."""
    path = _files(folder)[0]
    entries = json_of(path)
    if not isinstance(entries, list):
        raise CaptureError(f"{path.name} does not hold a list of cameras", AGAIN)
    return described(folder, [path], [_camera(entry, path.name) for entry in entries])


def _camera(entry: object, file: str) -> PeerCamera:
    photo = member(entry, "img_name", str, f"{file}: a camera")
    assert isinstance(entry, dict)  # `member` has checked it
    what = f"{file}: {photo}"
    width, height, fl_x, fl_y = (number(entry.get(key), f"{what}: {key}") for key in ("width", "height", "fx", "fy"))
    rotation = numbers(entry.get("rotation"), (3, 3), f"{what}: rotation")
    position = numbers(entry.get("position"), (3,), f"{what}: position")
    intrinsics = Intrinsics(round(width), round(height), fl_x, fl_y, width / 2, height / 2)
    return PeerCamera(photo, rotation, position, fixed(intrinsics))
