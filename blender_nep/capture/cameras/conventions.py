"""Finds out how the matrices of cameras are meant, where a file does not follow the convention of its format.

People write transforms.json by scripts, and mix up four things: the camera's axes (OpenGL's or OpenCV's), the direction
(camera to world or world to camera), rows and columns, and scale. The convention of the format is the given reading. It wins
if the cameras look at a common place by it, unless the photos clearly contradict it. Otherwise another reading counts, by
which nearly all cameras see a common place; if several do, those count by which the cameras turn around the place, then the
photos decide, and then the order of `_READINGS`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from blender_nep.capture.cameras.camera import Camera
from blender_nep.capture.cameras.common_place import common_place
from blender_nep.errors import CaptureError
from blender_nep.messages import Message

OPENGL, OPENCV, MITSUBA = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0]])
"""Signs of the columns of a camera-to-world rotation with such axes, for ours: x right, y up, looking down -z. Mitsuba's
cameras have x left, y up, and look along +z."""
_AS_IS, _INVERSE, _TURNED = "as is", "inverse", "turned"
"""How a matrix is made camera-to-world. `_TURNED`: only its rotation is from the world to the camera"""
_READINGS = (
    (_AS_IS, OPENCV),
    (_INVERSE, OPENCV),
    (_INVERSE, OPENGL),
    (_AS_IS, OPENGL),
    (_AS_IS, MITSUBA),
    (_TURNED, OPENGL),
    (_TURNED, OPENCV),
)
_ENOUGH = 0.5
"""If this share of the cameras sees the common place, the given reading is one that may be right."""
_NEARLY_ALL = 0.9
"""The same for another reading"""
_WIDE = 0.25
"""Radians (root mean square). Cameras turn around an object by more"""
_MOST_MISS = 0.4
"""The axes meet at a place if they pass it by less than this, relative to how far they differ from each other."""
_AGREES = 0.3
"""Share of common features: photos fit their cameras. By wrong cameras a twentieth fits by chance"""
_CLEARLY = 3.0
"""So many times as many features must fit another reading, where the given one may be right"""
_NEAREST = 0.02
"""Least distance of the common place from a camera, relative to how far the cameras lie apart"""
_MOST_SHEAR = 0.01
_UNIT = 0.01
"""A matrix whose scale is nearer to 1 than this is rounded, not scaled."""

Agreement = Callable[[Sequence[Camera]], float | None]
"""How well the photos fit these cameras: the share of their common features that do; None where too few are found"""


def read_poses(
    matrices: np.ndarray,
    cameras: Sequence[Camera],
    names: Sequence[str],
    agreement: Agreement,
    *,
    given_axes: np.ndarray = OPENGL,
    place: np.ndarray | None = None,
) -> tuple[np.ndarray, list[Message]]:
    """Camera-to-world matrices [n, 4, 4] with our axes, and warnings about what was not as the format demands.

    matrices [n, 4, 4], as the file has them, of the photos `names`. cameras: their intrinsics; the poses do not count.
    given_axes: the axes that the file says, `OPENGL` or another. place: [3] where the object is, if the file says so.
    Raises CaptureError where a matrix is neither rigid nor scaled alike in all directions, or where it mirrors.
    """
    matrices, warnings = _upright_matrices(matrices)
    scales = _scales(matrices, names)
    scaled = [name for name, scale in zip(names, scales, strict=True) if abs(scale - 1) > _UNIT]
    if scaled:
        warnings.append(Message("capture.cameras_scaled", {"count": len(scaled), "names": scaled}))
    given = _read(matrices, _AS_IS, given_axes)
    view = _view(given, cameras, None)
    stated = place is not None and _view(given, cameras, place).share >= _ENOUGH
    sound = stated or (view.share >= _ENOUGH and view.meets)
    if sound and view.turn >= _WIDE:
        return given, warnings
    others = []
    for how, axes in _READINGS:
        if how == _AS_IS and (axes == given_axes).all():
            continue
        if sound and how != _INVERSE:  # only an inverted matrix may look right, too: where the cameras hardly turn
            continue
        poses = _read(matrices, how, axes)
        other = _view(poses, cameras, place)
        if other.share >= _NEARLY_ALL:
            others.append(_Other(how, axes, poses, other.meets and other.turn >= _WIDE))
    if any(other.surely for other in others):
        others = [other for other in others if other.surely]
    if not others:
        return given, warnings
    fit, *fits = (agreement(_posed(cameras, poses)) or 0.0 for poses in (given, *(other.poses for other in others)))
    chosen = int(np.argmax(fits)) if max(fits) >= _AGREES else 0
    if sound or (view.share >= _ENOUGH and not others[chosen].surely):
        better = fits[chosen] >= _AGREES and fits[chosen] > _CLEARLY * fit
    else:
        better = fit < _AGREES or fit < fits[chosen]
    if not better:
        return given, warnings
    return others[chosen].poses, warnings + _told(others[chosen])


class _View(NamedTuple):
    """How cameras look at a place together."""

    share: float
    """The share of the cameras that have it in their picture"""
    turn: float
    """How far the optical axes differ from their mean (root mean square, radians)"""
    miss: float
    """By how much the axes pass the place (median, radians)"""

    @property
    def meets(self) -> bool:
        """Whether the axes meet there, and do not only run beside each other."""
        return self.miss <= _MOST_MISS * self.turn


class _Other(NamedTuple):
    """Another reading than the given one."""

    how: str
    axes: np.ndarray
    poses: np.ndarray
    surely: bool
    """Whether the cameras turn around their common place, which hardly happens by chance"""


def _upright_matrices(matrices: np.ndarray) -> tuple[np.ndarray, list[Message]]:
    """The matrices with their positions in the last column, and a warning if they stood in the last row."""
    last_row, last_column = matrices[:, 3, :3], matrices[:, :3, 3]
    if np.abs(last_column).max() <= 1e-9 * np.abs(last_row).max():
        return matrices.transpose(0, 2, 1), [Message("capture.cameras_transposed")]
    return matrices, []


def _scales(matrices: np.ndarray, names: Sequence[str]) -> np.ndarray:
    """The scale [n] of each matrix. Raises CaptureError where it is not alike in all directions, or where it mirrors."""
    scales = np.linalg.svd(matrices[:, :3, :3], compute_uv=False)
    mean = scales.mean(1)
    for name, matrix, scale in zip(names, matrices, scales, strict=True):
        rigid = scale.min() > 0 and np.abs(scale / scale.mean() - 1).max() <= _MOST_SHEAR
        if not rigid or np.abs(matrix[3] - [0, 0, 0, 1]).max() > 1e-6:
            raise CaptureError(
                f"{name}: transform_matrix is not rigid (it scales or shears)",
                "Camera-to-world needs a pure rotation and a position.",
            )
        if np.linalg.det(matrix[:3, :3]) < 0:
            raise CaptureError(f"{name}: transform_matrix mirrors", "Cameras are right-handed, look down -z, x right, y up.")
    return mean


def _read(matrices: np.ndarray, how: str, axes: np.ndarray) -> np.ndarray:
    """Camera-to-world matrices [n, 4, 4] with our axes, their rotations exactly orthonormal."""
    poses = np.linalg.inv(matrices) if how == _INVERSE else matrices.copy()
    for pose in poses:  # one by one: the product of a batch may differ in the last bits
        u, _, v = np.linalg.svd(pose[:3, :3])
        rotation = u @ v
        pose[:3, :3] = (rotation.T if how == _TURNED else rotation) * axes
    poses[:, 3] = [0, 0, 0, 1]
    return poses


def _view(poses: np.ndarray, cameras: Sequence[Camera], place: np.ndarray | None) -> _View:
    """How the cameras see `place`; if it is None, the place at which they look together. Distortion does not count."""
    position, axis = poses[:, :3, 3], -poses[:, :3, 2]
    turn = float(np.sqrt((_angle(axis, axis.mean(0)) ** 2).mean()))
    center = common_place(position, axis) if place is None else place
    if center is None or not np.isfinite(center).all():
        return _View(0.0, turn, np.inf)
    x, y, z = np.einsum("nji,nj->in", poses[:, :3, :3], center - position)
    width, height, fl_x, fl_y, cx, cy = np.array([(c.width, c.height, c.fl_x, c.fl_y, c.cx, c.cy) for c in cameras]).T
    # A place at a camera itself is none: cameras that stand at one place look together there.
    ahead = -z > _NEAREST * np.linalg.norm(position - position.mean(0), axis=1).max()
    depth = np.where(ahead, -z, 1.0)
    across, down = cx + fl_x * x / depth, cy - fl_y * y / depth
    inside = ahead & (across >= 0) & (across <= width) & (down >= 0) & (down <= height)
    return _View(float(inside.mean()), turn, float(np.median(_angle(axis, center - position))))


def _angle(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Angles [n] in radians between vectors [n, 3]."""
    lengths = np.linalg.norm(a, axis=-1) * np.linalg.norm(b, axis=-1)
    return np.arccos(np.clip((a * b).sum(-1) / np.maximum(lengths, 1e-300), -1, 1))


def _posed(cameras: Sequence[Camera], poses: np.ndarray) -> list[Camera]:
    return [replace(camera, camera_to_world=pose) for camera, pose in zip(cameras, poses, strict=True)]


def _told(other: _Other) -> list[Message]:
    out = []
    if other.how == _INVERSE:
        out.append(Message("capture.world_to_camera"))
    if other.how == _TURNED:
        out.append(Message("capture.rotations_turned"))
    if (other.axes == OPENCV).all():
        out.append(Message("capture.opencv_axes"))
    if (other.axes == MITSUBA).all():
        out.append(Message("capture.mitsuba_axes"))
    if other.how == _AS_IS and (other.axes == OPENGL).all():  # the file says other axes
        out.append(Message("capture.opengl_axes"))
    return out
