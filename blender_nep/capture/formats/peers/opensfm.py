"""Reads `reconstruction.json` of OpenSfM, which OpenDroneMap (ODM) has in its folder `opensfm`.

The file is a list of reconstructions with cameras and shots. A shot's rotation (an axis, as long as the angle in radians)
and translation lead from the world to the camera, whose axes are OpenCV's. Focal lengths and principal points are relative
to the longer side of the photo, principal points from its middle. Nothing says how several reconstructions lie to each
other: the one with the most shots is read.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from blender_nep.capture.cameras.lens import Lens
from blender_nep.capture.description import CaptureDescription
from blender_nep.capture.formats.peers.assembly import (
    AGAIN,
    Intrinsics,
    PeerCamera,
    described,
    files_with,
    json_of,
    member,
    number,
    numbers,
)
from blender_nep.errors import CaptureError

_PLACES = ("reconstruction.json", "opensfm/reconstruction.json")
_TERMS: dict[str, tuple[str, ...]] = {
    "perspective": ("k1", "k2"),
    "simple_radial": ("k1",),
    "radial": ("k1", "k2"),
    "brown": ("k1", "k2", "k3", "p1", "p2"),
    "fisheye": ("k1", "k2"),
    "fisheye_opencv": ("k1", "k2", "k3", "k4"),
}
"""{projection_type: its distortion}"""
_FISHEYE = ("fisheye", "fisheye_opencv")


def recognizes(folder: Path) -> bool:
    """Whether the folder holds such a file."""
    return bool(_reconstructions(folder))


def _reconstructions(folder: Path) -> list[Path]:
    return files_with(folder, _PLACES, b'"cameras"')


def read(folder: Path) -> CaptureDescription:
    """What the file says; photos are opened only for their size. Raises CaptureError."""
    path = _reconstructions(folder)[0]
    parts, file = json_of(path), path.name
    if not isinstance(parts, list) or not parts:
        raise CaptureError(f"{file} holds no list of reconstructions", AGAIN)
    shots = [member(part, "shots", dict, f"{file}: a reconstruction") for part in parts]
    largest = max(range(len(parts)), key=lambda n: len(shots[n]))
    models = member(parts[largest], "cameras", dict, f"{file}: a reconstruction")
    cameras = [_camera(name, shot, models, f"{file}: {name}") for name, shot in shots[largest].items()]
    without = [name for n, part in enumerate(shots) if n != largest for name in part if name not in shots[largest]]
    return described(folder, [path], cameras, without=without)


def _camera(name: str, shot: object, models: dict[str, Any], what: str) -> PeerCamera:
    model = member(models, member(shot, "camera", str, what), dict, what)
    assert isinstance(shot, dict)  # `member` has checked it
    rotation = _rotation(numbers(shot.get("rotation"), (3,), f"{what}: rotation"))
    translation = numbers(shot.get("translation"), (3,), f"{what}: translation")
    return PeerCamera(name, rotation.T, -rotation.T @ translation, partial(_intrinsics, model, what))


def _rotation(vector: np.ndarray) -> np.ndarray:
    """The matrix [3, 3] that turns around `vector` [3] by its length in radians."""
    angle = float(np.linalg.norm(vector))
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def _intrinsics(model: dict[str, Any], what: str, photo_width: int, photo_height: int) -> Intrinsics:
    kind = str(model.get("projection_type", "perspective")).lower()
    if kind not in _TERMS:
        raise CaptureError(
            f"{what}: projection type {kind} is not supported",
            f"Use one of these in OpenSfM: {', '.join(_TERMS)}; or the undistorted photos.",
        )

    def value(key: str, otherwise: float | None) -> float:
        return number(model.get(key, otherwise), f"{what}: {key}")

    width, height = value("width", photo_width), value("height", photo_height)
    side = max(width, height)
    fl_x = value("focal_x" if "focal_x" in model else "focal", None) * side
    fl_y = value("focal_y", None) * side if "focal_y" in model else fl_x
    terms = {term: value(term, 0.0) for term in _TERMS[kind]}
    cx, cy = value("c_x", 0.0) * side + width / 2, value("c_y", 0.0) * side + height / 2
    return Intrinsics(round(width), round(height), fl_x, fl_y, cx, cy, Lens(**terms, fisheye=kind in _FISHEYE))
