"""Reads the captures of LLFF: `poses_bounds.npy` [n, 17], and photos in `images/`, in the order of their names.

Where there is no `images/`, the smaller copies in `images_2/`, `images_4/` or `images_8/` count. A row is a matrix [3, 5],
and the nearest and farthest depth, which are not needed. The columns of the matrix are the camera's axes down, right and
backwards in the world, its position, and (height, width, focal length) in pixels. The principal point is the middle, and
there is no distortion. `mask_search.py` says where masks lie.
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from blender_nep.capture.cameras.camera import Camera
from blender_nep.capture.capture import View
from blender_nep.capture.description import MOST_VIEWS, CaptureDescription
from blender_nep.capture.formats.arrays import DAMAGED, read_npy
from blender_nep.capture.formats.mask_search import with_masks
from blender_nep.capture.formats.photo_search import first_with_photos
from blender_nep.capture.formats.photos import fitted, rescaled_warnings
from blender_nep.capture.formats.poses import camera_to_world, check_count, check_intrinsics, rotation_of
from blender_nep.errors import CaptureError

FILE = "poses_bounds.npy"
_PLACES = ("images", "images_2", "images_4", "images_8")


def recognizes(folder: Path) -> bool:
    """Whether the folder holds a capture of this format."""
    return (folder / FILE).is_file()


def read(folder: Path) -> CaptureDescription:
    """What the file says; photos are opened only for their size. Raises CaptureError."""
    poses = _read_poses(folder / FILE)
    place, photos = first_with_photos(folder, _PLACES)
    check_count(FILE, len(poses), f"{place}/", len(photos))
    rescaled: list[str] = []
    turned: list[str] = []
    views = []
    for pose, photo in zip(poses, photos, strict=True):
        camera = fitted(_camera(pose, photo.name), photo, photo.name, FILE, rescaled, turned)
        views.append(View(photo.stem, photo, None, camera))
    views, warnings = with_masks(folder, views)
    warnings += rescaled_warnings(rescaled, turned)
    return CaptureDescription(name=FILE, files=(folder / FILE,), views=views, warnings=warnings)


def _read_poses(path: Path) -> np.ndarray:
    """The matrices [n, 3, 5] of the file."""
    try:
        rows = read_npy(path, lambda shape: math.prod(shape) <= 17 * MOST_VIEWS)
    except DAMAGED as error:
        raise CaptureError(f"{path.name} cannot be read ({error})", "It must be an array of numbers.") from error
    if rows.ndim != 2 or rows.shape[1] != 17:
        raise CaptureError(
            f"{path.name} holds {rows.shape} numbers instead of rows of 17", "Make it with LLFF's imgs2poses."
        )
    return rows[:, :15].reshape(-1, 3, 5)


def _camera(pose: np.ndarray, name: str) -> Camera:
    what = f"{FILE}: {name}"
    height, width, focal = pose[:, 4].tolist()
    check_intrinsics(what, height, width, focal)
    down, right, backwards = pose[:, :3].T
    rotation = rotation_of(np.stack([right, -down, backwards], 1), what)
    matrix = camera_to_world(rotation, pose[:, 3], what)
    return Camera(round(width), round(height), focal, focal, width / 2, height / 2, matrix)
