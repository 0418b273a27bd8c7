"""Reads `sfm_data.json` of OpenMVG, or another file with such a name: views, intrinsics and extrinsics.

An extrinsic has the matrix from the world to the camera, row after row, and the camera's center. The camera's axes are
OpenCV's. Focal length and principal point are in pixels. Which lens it is, the name of its distortion says.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

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

_USUAL = "sfm_data.json"
_TERMS: dict[str, tuple[str, ...]] = {
    "disto_k1": ("k1",),
    "disto_k3": ("k1", "k2", "k3"),
    "disto_t2": ("k1", "k2", "k3", "p1", "p2"),
    "fisheye": ("k1", "k2", "k3", "k4"),
}
_SIZES = ("width", "height", "focal_length", "principal_point", "value0")


def recognizes(folder: Path) -> bool:
    """Whether the folder holds such a file."""
    return bool(_files(folder))


def _files(folder: Path) -> list[Path]:
    found = files_with(folder, ("sfm_data*.json",), b'"sfm_data_version"')
    return [path for path in found if path.name == _USUAL] or found


def read(folder: Path) -> CaptureDescription:
    """What the file says; photos are opened only for their size. Raises CaptureError."""
    path = only(_files(folder), "scenes of OpenMVG")
    scene, file = json_of(path), path.name
    views = member(scene, "views", list, file)
    lenses = {_key(entry): _data(entry, file) for entry in member(scene, "intrinsics", list, file)}
    poses = {_key(entry): member(entry, "value", dict, file) for entry in member(scene, "extrinsics", list, file)}
    cameras, without = [], []
    for view in views:
        said = _data(view, file)
        name = member(said, "filename", str, f"{file}: a view")
        photo = f"{str(said.get('local_path', '')).strip('/')}/{name}".lstrip("/")
        pose, lens = poses.get(str(said.get("id_pose"))), lenses.get(str(said.get("id_intrinsic")))
        if pose is None or lens is None:
            without.append(photo)
            continue
        what = f"{file}: {photo}"
        rotation = numbers(pose.get("rotation"), (3, 3), f"{what}: rotation")
        center = numbers(pose.get("center"), (3,), f"{what}: center")
        made = _intrinsics(lens, f"{file}: intrinsic {said.get('id_intrinsic')}")
        cameras.append(PeerCamera(photo, rotation.T, center, fixed(made)))
    return described(folder, [path], cameras, without=without)


def _key(entry: object) -> str:
    return str(entry.get("key")) if isinstance(entry, dict) else ""


def _data(entry: object, file: str) -> dict[str, Any]:
    """The content of a view or an intrinsic. Newer versions have a part of it in `value0`."""
    value = member(entry, "value", dict, f"{file}: an entry")
    data = member(member(value, "ptr_wrapper", dict, f"{file}: an entry"), "data", dict, f"{file}: an entry")
    inner = data.get("value0")
    return {**inner, **data} if isinstance(inner, dict) else data


def _intrinsics(data: dict[str, Any], what: str) -> Intrinsics:
    if "focal_length" not in data:
        raise CaptureError(f"{what}: a camera without focal length (spherical) is not supported", "Use pinhole cameras.")
    models = [key for key in data if key not in _SIZES]
    unknown = [key for key in models if key not in _TERMS]
    if unknown or len(models) > 1:
        raise CaptureError(
            f"{what}: the distortion {', '.join(unknown or models)} is not supported",
            "Use pinhole, pinhole_radial_k1, pinhole_radial_k3, pinhole_brown_t2 or fisheye in OpenMVG.",
        )
    width, height, focal = (number(data.get(key), f"{what}: {key}") for key in _SIZES[:3])
    cx, cy = numbers(data.get("principal_point"), (2,), f"{what}: principal_point").tolist()
    lens = Lens()
    for model in models:
        terms = numbers(data[model], (len(_TERMS[model]),), f"{what}: {model}").tolist()
        lens = Lens(**dict(zip(_TERMS[model], terms, strict=True)), fisheye=model == "fisheye")
    return Intrinsics(round(width), round(height), focal, focal, cx, cy, lens)
