"""Reads the captures of IDR, NeuS and their successors: `cameras_sphere.npz` or `cameras.npz`.

Photos lie in `image/` or `images/`, masks, if any, in `mask/` or `masks/`, both in the order of their names. `world_mat_0`,
`world_mat_1` and so on are P = K [R t], with OpenCV's axes. `scale_mat_0` takes the unit sphere to the object's sphere.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from scipy.linalg import rq

from blender_nep.capture.cameras.camera import Camera
from blender_nep.capture.cameras.lens import NO_DISTORTION, Lens
from blender_nep.capture.capture import View
from blender_nep.capture.description import CaptureDescription, check_number
from blender_nep.capture.formats.arrays import DAMAGED, read_npz
from blender_nep.capture.formats.mask_search import with_masks
from blender_nep.capture.formats.photo_search import first_with_photos
from blender_nep.capture.formats.poses import FROM_OPENCV, camera_to_world, check_count, check_intrinsics, rotation_of
from blender_nep.capture.photos.photo_files import image_size
from blender_nep.errors import CaptureError

FILES = ("cameras_sphere.npz", "cameras.npz")
_PHOTOS, _MASKS = ("image", "images"), ("mask", "masks")
_MATRICES = re.compile(r"(world|scale)_mat_\d+")
_LEAST_SKEW = 1e-4
"""Less skew than this, relative to the focal length, is rounding, and is left out."""
_CENTER = 0.5
"""Where these formats have the center of the first pixel at 0: NeuS casts the ray of column i through x = i, and its own
script for photos of a COLMAP project writes (w - 1) / 2 for the middle. We have it at 0.5."""


def recognizes(folder: Path) -> bool:
    """Whether the folder holds a capture of this format."""
    return any((folder / file).is_file() for file in FILES)


def read(folder: Path) -> CaptureDescription:
    """What the file says; photos are opened only for their size. Raises CaptureError."""
    path = next(folder / file for file in FILES if (folder / file).is_file())
    stored = _read_matrices(path)
    cameras = sum(name.startswith("world_mat_") for name in stored)
    check_number(cameras, path.name)
    place, photos = first_with_photos(folder, _PHOTOS)
    check_count(path.name, cameras, f"{place}/", len(photos))
    mask_place, masks = first_with_photos(folder, _MASKS)
    if masks and len(masks) != len(photos):
        raise CaptureError(
            f"the number of masks in {mask_place}/ ({len(masks)}) is not that of the cameras of {path.name} ({cameras})",
            "There must be a mask for every photo, in the order of the names, or none.",
        )
    views = []
    for i, photo in enumerate(photos):
        what = f"{path.name}: world_mat_{i} of {photo.name}"
        camera = _camera(_matrix(stored, f"world_mat_{i}", path), image_size(photo), what)
        views.append(View(photo.stem, photo, masks[i] if masks else None, camera))
    views, found = with_masks(folder, views)
    return CaptureDescription(path.name, (path,), views, None, *_sphere(stored, path), found)


def _read_matrices(path: Path) -> dict[str, np.ndarray]:
    try:
        return read_npz(path, _MATRICES, lambda shape: shape in ((3, 4), (4, 4)))
    except DAMAGED as error:
        raise CaptureError(f"{path.name} cannot be read ({error})", "It must be a file of numpy.savez.") from error


def _matrix(stored: dict[str, np.ndarray], name: str, path: Path) -> np.ndarray:
    """The upper three rows [3, 4] of a matrix of the file."""
    matrix = stored.get(name)
    if matrix is None or matrix.shape not in ((3, 4), (4, 4)) or not np.isfinite(matrix[:3]).all():
        raise CaptureError(f"{path.name} has no {name} that is a 4 x 4 matrix of numbers", "Make the file again.")
    return matrix[:3]


def _camera(projection: np.ndarray, size: tuple[int, int], what: str) -> Camera:
    """The camera whose P = K [R t] is `projection` [3, 4], of any positive scale."""
    left = projection[:, :3]
    if abs(np.linalg.det(left)) <= 1e-12 * np.linalg.norm(left, axis=1).prod():
        raise CaptureError(f"{what} is no camera: it has no focal length", "Make the file again.")
    if np.linalg.det(left) < 0:
        raise CaptureError(f"{what} mirrors", "It must be K [R t] with a right-handed rotation R.")
    upper, rotation = rq(left)
    signs = np.sign(np.diag(upper))  # the product stays the same, and the diagonal of K becomes positive
    upper, rotation = upper * signs, signs[:, None] * rotation
    upper /= upper[2, 2]
    fl_x, fl_y = float(upper[0, 0]), float(upper[1, 1])
    check_intrinsics(what, fl_x, fl_y)
    skew = float(upper[0, 1]) / fl_x
    lens = Lens(skew=skew) if abs(skew) > _LEAST_SKEW else NO_DISTORTION
    position = -np.linalg.solve(left, projection[:, 3])
    matrix = camera_to_world(rotation_of(rotation.T * FROM_OPENCV, what), position, what)
    return Camera(*size, fl_x, fl_y, float(upper[0, 2]) + _CENTER, float(upper[1, 2]) + _CENTER, matrix, lens)


def _sphere(stored: dict[str, np.ndarray], path: Path) -> tuple[list[float] | None, float | None]:
    """Center and radius of the object's sphere; None where the file has no scale_mat."""
    if not any(name.startswith("scale_mat_") for name in stored):
        return None, None
    matrix = _matrix(stored, "scale_mat_0", path)
    radius = float(np.linalg.norm(matrix[:, :3]) / np.sqrt(3))
    if radius <= 0 or np.abs(matrix[:, :3] @ matrix[:, :3].T / radius**2 - np.eye(3)).max() > 0.01:
        raise CaptureError(f"{path.name}: scale_mat_0 does not take a sphere to a sphere", "Make the file again.")
    return matrix[:, 3].tolist(), radius
