"""Reads `cameras.sfm`, or another `.sfm` file, of Meshroom and AliceVision: JSON with views, intrinsics and poses.

The nine numbers of a pose's rotation are the matrix from the world to the camera, column after column. The camera's axes are
OpenCV's. Numbers are written as text. The intrinsics depend on the version of the file:

- before 1.2.0: `pxFocalLength` is a number of pixels; before 1.2.2 it has two numbers
- from 1.2.2: `focalLength` and `sensorWidth` are in mm, so fl_x = focalLength / sensorWidth * width
- `pixelRatio` is fl_x / fl_y before 1.2.5, and fl_y / fl_x from then on
- `principalPoint` is in pixels, from the image's corner before 1.2.1, and from its middle from then on
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from blender_nep.capture.cameras.lens import Lens
from blender_nep.capture.description import CaptureDescription
from blender_nep.capture.formats.peers.assembly import (
    Intrinsics,
    PeerCamera,
    described,
    files_with,
    fixed,
    json_of,
    member,
    number,
    numbers,
    only,
)
from blender_nep.errors import CaptureError

_USUAL = "cameras.sfm"
_TERMS: dict[str, tuple[str, ...]] = {
    "pinhole": (),
    "none": (),
    "radial1": ("k1",),
    "radialk1": ("k1",),
    "radial3": ("k1", "k2", "k3"),
    "radialk3": ("k1", "k2", "k3"),
    "brown": ("k1", "k2", "k3", "p1", "p2"),
    "fisheye": ("k1", "k2", "k3", "k4"),
    "fisheye4": ("k1", "k2", "k3", "k4"),
}
"""{distortion: the terms of our lens, in the order of distortionParams}"""
_FISHEYE = ("fisheye", "fisheye4")


def recognizes(folder: Path) -> bool:
    """Whether the folder holds such a file."""
    return bool(_scenes(folder))


def _scenes(folder: Path) -> list[Path]:
    found = files_with(folder, ("*.sfm",), b'"version"')
    return [path for path in found if path.name == _USUAL] or found


def read(folder: Path) -> CaptureDescription:
    """What the file says; photos are opened only for their size. Raises CaptureError."""
    path = only(_scenes(folder), "scenes of Meshroom")
    scene, file = json_of(path), path.name
    version = _version(scene, file)
    views = member(scene, "views", list, file)
    intrinsics = {str(entry.get("intrinsicId")): entry for entry in _objects(scene, "intrinsics")}
    poses = {str(entry.get("poseId")): entry for entry in _objects(scene, "poses")}
    cameras, without = [], []
    for view in views:
        photo = member(view, "path", str, f"{file}: a view")
        pose, lens = poses.get(str(view.get("poseId"))), intrinsics.get(str(view.get("intrinsicId")))
        if pose is None or lens is None:
            without.append(photo)
            continue
        what = f"{file}: {photo}"
        if "rigId" in view and str(view.get("isPoseIndependant", "true")).lower() in ("false", "0"):
            raise CaptureError(f"{what}: cameras of a rig are not supported", "Compute the cameras without rigs.")
        transform = member(member(pose, "pose", dict, what), "transform", dict, what)
        to_world = numbers(transform.get("rotation"), (3, 3), f"{what}: rotation")
        center = numbers(transform.get("center"), (3,), f"{what}: center")
        made = _intrinsics(lens, version, f"{file}: intrinsics {lens.get('intrinsicId')}")
        cameras.append(PeerCamera(photo, to_world, center, fixed(made)))
    return described(folder, [path], cameras, without=without)


def _objects(scene: dict[str, Any], key: str) -> list[dict[str, Any]]:
    entries = scene.get(key, [])
    return [entry for entry in entries if isinstance(entry, dict)] if isinstance(entries, list) else []


def _version(scene: object, file: str) -> tuple[int, ...]:
    values = numbers(member(scene, "version", list, file), (3,), f"{file}: version")
    return tuple(int(value) for value in values)


def _intrinsics(entry: dict[str, Any], version: tuple[int, ...], what: str) -> Intrinsics:
    width, height = (number(entry.get(key), f"{what}: {key}") for key in ("width", "height"))
    fl_x, fl_y = _focal_lengths(entry, version, width, what)
    principal = numbers(entry.get("principalPoint", [0, 0]), (2,), f"{what}: principalPoint")
    if version >= (1, 2, 1):
        principal = principal + np.array([width, height]) / 2
    cx, cy = principal.tolist()
    return Intrinsics(round(width), round(height), fl_x, fl_y, cx, cy, _lens(entry, what))


def _focal_lengths(entry: dict[str, Any], version: tuple[int, ...], width: float, what: str) -> tuple[float, float]:
    if version < (1, 2, 0):
        focal = number(entry.get("pxFocalLength"), f"{what}: pxFocalLength")
        return focal, focal
    if version < (1, 2, 2):
        fl_x, fl_y = numbers(entry.get("pxFocalLength"), (2,), f"{what}: pxFocalLength").tolist()
        return fl_x, fl_y
    sensor = number(entry.get("sensorWidth", 36), f"{what}: sensorWidth")
    ratio = number(entry.get("pixelRatio", 1), f"{what}: pixelRatio")
    if sensor <= 0 or ratio <= 0:
        raise CaptureError(f"{what}: sensorWidth and pixelRatio must be positive", "Export the cameras again.")
    focal = number(entry.get("focalLength"), f"{what}: focalLength") / sensor * width
    return focal, focal / ratio if version < (1, 2, 5) else focal * ratio


def _lens(entry: dict[str, Any], what: str) -> Lens:
    """The lens. Raises CaptureError for one that `Lens` does not have."""
    kind = str(entry.get("type", "")).lower()
    distortion = str(entry.get("distortionType") or kind).lower()
    params = entry.get("distortionParams") or []
    values = numbers(params, (len(params),), f"{what}: distortionParams").tolist() if isinstance(params, list) else [1.0]
    undistortion = entry.get("undistortionParams") or []
    undistortion = undistortion if isinstance(undistortion, list) else [undistortion]
    if kind in _TERMS and distortion in _TERMS and len(values) <= len(_TERMS[distortion]) and not undistortion:
        return Lens(**dict(zip(_TERMS[distortion], values, strict=False)), fisheye=distortion in _FISHEYE)
    if kind == "pinhole" and isinstance(params, list) and not any(number(value, what) for value in (*params, *undistortion)):
        return Lens()  # a model that distorts nothing may have any name
    raise CaptureError(
        f"{what}: camera type {kind} with distortion {distortion} is not supported",
        "Use pinhole, radial1, radial3, brown or fisheye in Meshroom, or its undistorted photos (PrepareDenseScene).",
    )
