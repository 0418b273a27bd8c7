"""What the readers of other programs' cameras share: finding their files, reading numbers, and making views of cameras."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import astuple
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from blender_nep.capture.cameras.camera import Camera
from blender_nep.capture.cameras.lens import NO_DISTORTION, Lens
from blender_nep.capture.capture import View
from blender_nep.capture.description import CaptureDescription, check_number
from blender_nep.capture.formats.mask_search import with_masks
from blender_nep.capture.formats.photo_search import IMAGES_FIRST, check_distinct, photos_named
from blender_nep.capture.formats.photos import check_readable, fitted, rescaled_warnings
from blender_nep.capture.formats.poses import (
    FROM_OPENCV,
    camera_to_world,
    check_intrinsics,
    rotation_of,
    without_pose_warnings,
)
from blender_nep.capture.photos.photo_files import image_size
from blender_nep.errors import CaptureError
from blender_nep.safety.plain_files import open_plain, read_json

_BEGIN_BYTES = 1 << 16
_MOST = 1e15
"""Larger numbers are damage: sizes, angles and places on Earth in millimeters are smaller"""
AGAIN = "Export the cameras again."


class Intrinsics(NamedTuple):
    """Size, focal lengths and principal point in pixels, where the first pixel's center is at 0.5, and the lens."""

    width: int
    height: int
    fl_x: float
    fl_y: float
    cx: float
    cy: float
    lens: Lens = NO_DISTORTION


def fixed(intrinsics: Intrinsics) -> Callable[[int, int], Intrinsics]:
    """These intrinsics, whatever size the photo has: its file says the size itself."""
    return lambda width, height: intrinsics


class PeerCamera(NamedTuple):
    """A camera as another program has it."""

    photo: str
    """What the file calls its photo"""
    rotation: np.ndarray
    """[3, 3] from the camera to the world. The camera's axes are OpenCV's: x right, y down, z ahead"""
    position: np.ndarray
    """[3]"""
    intrinsics: Callable[[int, int], Intrinsics]
    """The intrinsics for the photo's width and height, which some files do not say"""


def files_with(folder: Path, patterns: Sequence[str], *marks: bytes) -> list[Path]:
    """The files of `folder` with one of the patterns that begin with text in which all `marks` stand, sorted."""
    found = []
    for pattern in patterns:
        found += [path for path in sorted(folder.glob(pattern)) if not path.name.startswith(".") and _has(path, marks)]
    return found


def _has(path: Path, marks: Sequence[bytes]) -> bool:
    try:
        with open_plain(path, sys.maxsize) as file:
            begin = file.read(_BEGIN_BYTES)
    except OSError:
        return False
    return all(mark in begin for mark in marks)


Z_UP = [2, 0, 1]
"""The rows of a matrix of ARKit, whose y is up, that become x, y and z of a capture whose z is up"""


def rotation_of_quaternion(quaternion: Sequence[float], what: str) -> np.ndarray:
    """The matrix [3, 3] of a quaternion w x y z of length 1. Raises CaptureError for other lengths."""
    length = float(np.linalg.norm(quaternion))
    if not 0.9 < length < 1.1:
        raise CaptureError(f"{what}: its pose is not rigid", AGAIN)
    w, x, y, z = (value / length for value in quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def only(found: list[Path], what: str) -> Path:
    """The only one of the files. Raises CaptureError if there are several."""
    if len(found) > 1:
        names = ", ".join(path.name for path in found)
        raise CaptureError(f"{found[0].parent} has several {what}: {names}", "Leave only the one that counts.")
    return found[0]


def json_of(path: Path) -> Any:
    """What the JSON file holds. Raises CaptureError."""
    try:
        return read_json(path, None)
    except (OSError, ValueError) as error:
        raise CaptureError(f"{path.name} cannot be read ({error})", AGAIN) from error


def member(holder: object, key: str, kind: type[Any], what: str) -> Any:
    """The value of `key` in a JSON object. Raises CaptureError where it is missing, or is not of that kind."""
    value = holder.get(key) if isinstance(holder, dict) else None
    if not isinstance(value, kind):
        names: dict[Any, str] = {list: "list", dict: "JSON object", str: "text"}
        raise CaptureError(f"{what} has no {names[kind]} {key!r}", AGAIN)
    return value


def number(value: object, what: str) -> float:
    """The number that a file has as a number or as text. Raises CaptureError if it is none, or too large."""
    try:
        read = math.nan if isinstance(value, bool) else float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        read = math.nan
    if not abs(read) <= _MOST:
        raise CaptureError(f"{what} is not a number: {str(value)[:40]}", AGAIN)
    return read


def numbers(value: object, shape: tuple[int, ...], what: str) -> np.ndarray:
    """The numbers of a list, or of lists in lists, as an array of that shape. Raises CaptureError."""
    try:
        read = np.array(value, np.float64)
    except (TypeError, ValueError, OverflowError):
        read = np.zeros(0)
    if read.size != math.prod(shape) or not (np.abs(read) <= _MOST).all():
        raise CaptureError(f"{what} is not {math.prod(shape)} numbers", AGAIN)
    return read.reshape(shape)


def described(
    folder: Path,
    files: Sequence[Path],
    cameras: Sequence[PeerCamera],
    *,
    without: Sequence[str] = (),
    places: tuple[str, ...] = IMAGES_FIRST,
    name: str = "",
) -> CaptureDescription:
    """The capture of the cameras, with the photos and masks that are there. Raises CaptureError.

    `without`: photos that the files list without a pose. `places`: the folders where the photos lie. `name`: what messages
    call the files; the first file's name, if it is empty.
    """
    file = name or files[0].name
    check_number(len(cameras) + len(without), file)
    if not cameras:
        raise CaptureError(f"{file} has no photos with a pose", "Compute the cameras again.")
    photos, missing = photos_named(folder, [camera.photo for camera in cameras], file, places)
    rescaled: list[str] = []
    turned: list[str] = []
    views = []
    for peer in cameras:
        if peer.photo not in photos:
            continue
        image, what = photos[peer.photo], f"{file}: {peer.photo}"
        check_readable(image, peer.photo)
        camera = _camera(peer, image, what)
        camera = fitted(camera, image, peer.photo, file, rescaled, turned)
        views.append(View(_name(folder, image, places), image, None, camera))
    check_distinct(views, file)
    views, found = with_masks(folder, views)
    warnings = without_pose_warnings(list(without)) + missing + found + rescaled_warnings(rescaled, turned)
    return CaptureDescription(name=file, files=tuple(files), views=views, warnings=warnings)


def _camera(peer: PeerCamera, image: Path, what: str) -> Camera:
    intrinsics = peer.intrinsics(*image_size(image))
    check_intrinsics(what, *intrinsics[:4])
    if not np.isfinite([intrinsics.cx, intrinsics.cy, *astuple(intrinsics.lens)]).all():
        raise CaptureError(f"{what}: principal point and distortion must be finite", AGAIN)
    matrix = camera_to_world(rotation_of(peer.rotation, what) * FROM_OPENCV, peer.position, what)
    return Camera(*intrinsics[:6], matrix, intrinsics.lens)


def _name(folder: Path, image: Path, places: tuple[str, ...]) -> str:
    """The photo's place in its folder of photos, without the ending."""
    for place in sorted(places, key=len, reverse=True):
        if image.is_relative_to(folder / place):
            return image.relative_to(folder / place).with_suffix("").as_posix()
    return image.stem
