"""Reads the unpacked `.r3d` file of Record3D: `metadata.json`, and photos `0.jpg`, `1.jpg` and so on in `rgb/`.

A pose is a quaternion x y z w and a position, from the camera to the world. The camera's axes are ours; the world's y is up,
as in ARKit. The capture's z is up: x, y, z here are Record3D's z, x, y. K is a matrix in pixels, column after column, and
`perFrameIntrinsicCoeffs` (fx, fy, cx, cy), where it is there, has intrinsics for each photo.
"""

from __future__ import annotations

from pathlib import Path

from blender_nep.capture.description import CaptureDescription, check_number
from blender_nep.capture.formats.peers.assembly import (
    Z_UP,
    Intrinsics,
    PeerCamera,
    described,
    files_with,
    fixed,
    json_of,
    member,
    number,
    numbers,
    rotation_of_quaternion,
)
from blender_nep.capture.formats.poses import FROM_OPENCV

_PHOTOS = "rgb"


def recognizes(folder: Path) -> bool:
    """Whether the folder holds such data."""
    return bool(_files(folder))


def _files(folder: Path) -> list[Path]:
    return files_with(folder, ("metadata.json",), b'"poses"') if (folder / _PHOTOS).is_dir() else []


def read(folder: Path) -> CaptureDescription:
    """What the file says; photos are opened only for their size. Raises CaptureError."""
    path = _files(folder)[0]
    said, file = json_of(path), path.name
    poses = member(said, "poses", list, file)
    check_number(len(poses), file)
    width, height = (round(number(said.get(key), f"{file}: {key}")) for key in ("w", "h"))
    k = numbers(said.get("K"), (3, 3), f"{file}: K").T
    whole = [float(k[0, 0]), float(k[1, 1]), float(k[0, 2]), float(k[1, 2])]
    each = said.get("perFrameIntrinsicCoeffs")
    own = numbers(each, (len(poses), 4), f"{file}: perFrameIntrinsicCoeffs").tolist() if each else [whole] * len(poses)
    cameras = []
    for n, (pose, inner) in enumerate(zip(poses, own, strict=True)):
        x, y, z, w, *position = numbers(pose, (7,), f"{file}: pose {n}").tolist()
        rotation = rotation_of_quaternion((w, x, y, z), f"{file}: pose {n}")[Z_UP] * FROM_OPENCV
        place = numbers(position, (3,), file)[Z_UP]
        cameras.append(PeerCamera(str(n), rotation, place, fixed(Intrinsics(width, height, *inner))))
    return described(folder, [path], cameras, places=(_PHOTOS,))
