"""Reads `meta_data.json` of sdfstudio: frames with `rgb_path`, `camtoworld` and `intrinsics`.

`camtoworld` leads from the camera, whose axes are OpenCV's, to the world. `intrinsics` is a matrix in pixels. `width` and
`height` stand at the top.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from blender_nep.capture.cameras.lens import Lens
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

_MODELS = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE")


def recognizes(folder: Path) -> bool:
    """Whether the folder holds such a file."""
    return bool(_files(folder))


def _files(folder: Path) -> list[Path]:
    return files_with(folder, ("meta_data.json",), b'"camtoworld"')


def read(folder: Path) -> CaptureDescription:
    """What the file says; photos are opened only for their size. Raises CaptureError."""
    path = _files(folder)[0]
    said, file = json_of(path), path.name
    frames = member(said, "frames", list, file)
    model = str(said.get("camera_model", "OPENCV")).upper()
    if model not in _MODELS:
        raise CaptureError(f"{file}: camera_model {model} is not supported", f"Use one of these: {', '.join(_MODELS)}.")
    width, height = (round(number(said.get(key), f"{file}: {key}")) for key in ("width", "height"))
    cameras = []
    for frame in frames:
        photo = member(frame, "rgb_path", str, f"{file}: a frame")
        what = f"{file}: {photo}"
        pose = _matrix(frame.get("camtoworld"), f"{what}: camtoworld")
        k = _matrix(frame.get("intrinsics"), f"{what}: intrinsics")
        if k[0, 0] == 0:
            raise CaptureError(f"{what}: focal length and size must be positive", AGAIN)
        lens = Lens(skew=float(k[0, 1] / k[0, 0]))
        made = Intrinsics(width, height, float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2]), lens)
        cameras.append(PeerCamera(photo, pose[:3, :3], pose[:3, 3], fixed(made)))
    return described(folder, [path], cameras)


def _matrix(value: object, what: str) -> np.ndarray:
    """A matrix with 3 or 4 rows and columns."""
    rows = len(value) if isinstance(value, list) else 0
    columns = len(value[0]) if rows and isinstance(value, list) and isinstance(value[0], list) else 0
    if not (3 <= rows <= 4 and 3 <= columns <= 4):
        raise CaptureError(f"{what} is not a matrix", AGAIN)
    return numbers(value, (rows, columns), what)
