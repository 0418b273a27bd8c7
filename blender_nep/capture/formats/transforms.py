"""Reads `transforms.json`, the format of instant-ngp and nerfstudio.

Three optional keys are added: `object_center`, `object_radius` and `color_space`. `cameras/lens_keys.py` reads the
intrinsics and the lens, which stand at the top or in a frame.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from blender_nep.capture.cameras.camera import Camera
from blender_nep.capture.cameras.lens_keys import LensKeys
from blender_nep.capture.capture import View
from blender_nep.capture.description import CaptureDescription
from blender_nep.capture.formats.photo_search import photos_named
from blender_nep.capture.formats.photos import check_readable, fitted, rescaled_warnings
from blender_nep.capture.photos.photo_files import find_image, image_size
from blender_nep.capture.photos.photo_lookup import PLACES, stem
from blender_nep.errors import CaptureError
from blender_nep.messages import Message

FILE = "transforms.json"


def recognizes(folder: Path, file: str = FILE) -> bool:
    """Whether the folder holds a capture of this format."""
    return (folder / file).is_file()


def read(folder: Path, file: str = FILE) -> CaptureDescription:
    """What the file says; photos are opened only for their size. Raises CaptureError."""
    meta = _read_json(folder / file)
    frames = meta.get("frames")
    if not isinstance(frames, list) or not frames:
        raise CaptureError(f"{file} lists no frames", "It needs a list 'frames' with file_path and transform_matrix.")
    named = [(_photo_name(frame, n), frame) for n, frame in enumerate(frames)]
    photos, warnings = photos_named(folder, [name for name, _ in named], file, PLACES, absolute_first=True)
    rescaled: list[str] = []
    odd_angles: list[str] = []
    views = [_view(folder, file, meta, frame, photos[name], rescaled, odd_angles) for name, frame in named if name in photos]
    if odd_angles:
        warnings.append(Message("capture.angles_disagree", {"count": len(odd_angles), "names": odd_angles}))
    return CaptureDescription(
        name=file,
        files=(folder / file,),
        views=views,
        color_space=meta.get("color_space"),
        object_center=meta.get("object_center"),
        object_radius=meta.get("object_radius"),
        warnings=warnings + rescaled_warnings(rescaled),
    )


def _read_json(path: Path) -> dict:
    try:
        meta = json.loads(path.read_text(encoding="utf-8-sig"))  # some editors write a byte order mark
    except (OSError, ValueError) as error:
        raise CaptureError(f"{path.name} cannot be read ({error})", "It must be JSON text.") from error
    if not isinstance(meta, dict):
        raise CaptureError(f"{path.name} does not hold a JSON object")
    return meta


def _photo_name(frame: object, n: int) -> str:
    """What frame `n` calls its photo."""
    if not isinstance(frame, dict):
        raise CaptureError(f"frame {n} is not a JSON object")
    if not isinstance(frame.get("file_path"), str):
        raise CaptureError(f"frame {n} has no file_path")
    return frame["file_path"]


def _view(folder: Path, file: str, meta: dict, frame: dict, image: Path, rescaled: list[str], odd_angles: list[str]) -> View:
    name = frame["file_path"]
    check_readable(image, name)
    parts = LensKeys(meta, frame, name).camera_parts(lambda: image_size(image), odd_angles)
    camera = Camera(camera_to_world=_matrix(frame, name), **parts)
    mask = None
    if frame.get("mask_path"):
        mask = find_image(folder, str(frame["mask_path"]))
        if mask is None:
            raise CaptureError(f"mask {frame['mask_path']} is missing", "Put it back, or take mask_path out of its frame.")
    return View(stem(image.name), image, mask, fitted(camera, image, name, file, rescaled))


def _matrix(frame: dict, name: str) -> np.ndarray:
    """The frame's camera-to-world matrix [4, 4], with its rotation made exactly orthonormal.

    Raises CaptureError if the matrix is missing, scales, shears or mirrors.
    """
    try:
        matrix = np.array(frame.get("transform_matrix"), np.float64)
    except (TypeError, ValueError, OverflowError):
        matrix = np.zeros(0)
    if matrix.shape == (3, 4):
        matrix = np.concatenate([matrix, [[0.0, 0.0, 0.0, 1.0]]])
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        raise CaptureError(f"{name}: transform_matrix is not a 4 x 4 matrix of numbers")
    u, scale, v = np.linalg.svd(matrix[:3, :3])
    if np.abs(scale - 1).max() > 0.01 or np.abs(matrix[3] - [0, 0, 0, 1]).max() > 1e-6:
        raise CaptureError(
            f"{name}: transform_matrix is not rigid (it scales or shears)",
            "Camera-to-world needs a pure rotation and a position.",
        )
    if np.linalg.det(u @ v) < 0:
        raise CaptureError(f"{name}: transform_matrix mirrors", "Cameras are right-handed, look down -z, x right, y up.")
    matrix[:3, :3] = u @ v
    return matrix
