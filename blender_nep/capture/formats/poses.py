"""What the formats of other programs share: matrices that must be rotations, and the warning about photos without a pose."""

from __future__ import annotations

import numpy as np

from blender_nep.capture.photos.photo_files import SUFFIXES
from blender_nep.errors import CaptureError
from blender_nep.messages import Message

FROM_OPENCV = np.array([1.0, -1.0, -1.0])
"""Turns camera-to-world columns from OpenCV's axes (x right, y down, z ahead) to ours (y up, looking down -z)."""


def rotation_of(matrix: np.ndarray, what: str) -> np.ndarray:
    """The rotation [3, 3] nearest to `matrix` [3, 3]. Raises CaptureError if that is not finite, scales, shears or mirrors.

    `what` names the file and the photo for the message.
    """
    if not np.isfinite(matrix).all():
        raise CaptureError(f"{what}: its pose is not finite", "Export the cameras again.")
    u, scale, v = np.linalg.svd(matrix)
    if np.abs(scale - 1).max() > 0.01:
        raise CaptureError(f"{what}: its pose is not rigid (it scales or shears)", "Export the cameras again.")
    if np.linalg.det(u @ v) < 0:
        raise CaptureError(f"{what}: its pose mirrors", "The axes of all cameras must be right-handed.")
    return u @ v


def camera_to_world(rotation: np.ndarray, position: np.ndarray, what: str) -> np.ndarray:
    """The matrix [4, 4] of a rotation [3, 3] whose columns are our axes, and a position [3].

    Raises CaptureError if the position is not finite.
    """
    if not np.isfinite(position).all():
        raise CaptureError(f"{what}: its pose is not finite", "Export the cameras again.")
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    matrix[:3, 3] = position
    return matrix


def without_pose_warnings(names: list[str]) -> list[Message]:
    """The warning about photos that a file lists without a pose; none without such photos."""
    return [Message("capture.photos_without_pose", {"count": len(names), "names": names})] if names else []


def check_intrinsics(what: str, *values: float) -> None:
    """Raises CaptureError if focal lengths or sizes are not positive and finite."""
    if not all(np.isfinite(value) and value > 0 for value in values):
        raise CaptureError(f"{what}: focal length and size must be positive", "Export the cameras again.")


def check_count(file: str, cameras: int, place: str, photos: int) -> None:
    """Raises CaptureError if a file has not as many cameras as there are photos. They belong together by their order."""
    if cameras != photos:
        raise CaptureError(
            f"{file} has {cameras} cameras, but {place} has {photos} photos ({', '.join(s[1:] for s in SUFFIXES)})",
            "Both must be equal, because the order of the names says which camera belongs to which photo.",
        )
