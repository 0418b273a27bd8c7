"""Reads `transforms.json`, the format of instant-ngp and nerfstudio.

Three optional keys are added: `object_center`, `object_radius` and `color_space`. The intrinsics `fl_x fl_y cx cy w h` stand
at the top or in a frame. Where `fl_x` is missing, `camera_angle_x` (radians) gives it. `camera_model` and the distortion `k1
k2 k3 k4 p1 p2` stand there, too. Where `camera_model` is missing, instant-ngp's `is_fisheye` says whether it is a fisheye.
"""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np

from blender_nep.capture.cameras.camera import Camera
from blender_nep.capture.cameras.lens import Lens
from blender_nep.capture.capture import View
from blender_nep.capture.description import CaptureDescription
from blender_nep.capture.formats.mask_search import with_masks
from blender_nep.capture.formats.photos import check_readable, fitted, rescaled_warnings
from blender_nep.capture.photos.photo_files import find_image, image_size
from blender_nep.errors import CaptureError

FILE = "transforms.json"
_OPENCV = ("PINHOLE", "SIMPLE_PINHOLE", "OPENCV", "PERSPECTIVE", "SIMPLE_RADIAL", "RADIAL")
_FISHEYE = ("OPENCV_FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE")
_TERMS = ("k1", "k2", "k3", "k4", "p1", "p2")


def recognizes(folder: Path, file: str = FILE) -> bool:
    """Whether the folder holds a capture of this format."""
    return (folder / file).is_file()


def read(folder: Path, file: str = FILE) -> CaptureDescription:
    """What the file says; photos are opened only for their size. Raises CaptureError."""
    meta = _read_json(folder / file)
    frames = meta.get("frames")
    if not isinstance(frames, list) or not frames:
        raise CaptureError(f"{file} lists no frames", "It needs a list 'frames' with file_path and transform_matrix.")
    rescaled: list[str] = []
    views = [_view(folder, file, meta, _dict(frame, n), n, rescaled) for n, frame in enumerate(frames)]
    views, found = with_masks(folder, views, named_by_file=True)
    return CaptureDescription(
        name=file,
        files=(folder / file,),
        views=views,
        color_space=meta.get("color_space"),
        object_center=meta.get("object_center"),
        object_radius=meta.get("object_radius"),
        warnings=found + rescaled_warnings(rescaled),
    )


def _read_json(path: Path) -> dict:
    try:
        meta = json.loads(path.read_text(encoding="utf-8-sig"))  # some editors write a byte order mark
    except (OSError, ValueError) as error:
        raise CaptureError(f"{path.name} cannot be read ({error})", "It must be JSON text.") from error
    if not isinstance(meta, dict):
        raise CaptureError(f"{path.name} does not hold a JSON object")
    return meta


def _lens(meta: dict, frame: dict, name: str) -> Lens:
    """The distortion of a frame's camera. Raises CaptureError for a model that is not known."""
    default = "OPENCV_FISHEYE" if frame.get("is_fisheye", meta.get("is_fisheye")) else "OPENCV"
    model = str(frame.get("camera_model") or meta.get("camera_model") or default).upper()
    if model not in _OPENCV + _FISHEYE:
        raise CaptureError(
            f"camera model {model} is not supported",
            "Use PINHOLE, OPENCV or OPENCV_FISHEYE, or undistort the photos.",
        )
    k1, k2, k3, k4, p1, p2 = (_number(frame, meta, key, name) or 0.0 for key in _TERMS)
    lens = Lens(k1, k2, k3, k4, p1, p2, fisheye=model in _FISHEYE)
    if lens.fisheye and (lens.p1 or lens.p2):
        raise CaptureError(f"{name}: a fisheye lens has no p1 and p2", "Take them out, or correct camera_model.")
    return lens


def _dict(frame: object, n: int) -> dict:
    if not isinstance(frame, dict):
        raise CaptureError(f"frame {n} is not a JSON object")
    return frame


def _number(frame: dict, meta: dict, key: str, name: str) -> float | None:
    value = frame.get(key, meta.get(key))
    if value is None:
        return None
    try:
        number = math.nan if isinstance(value, bool) or not isinstance(value, int | float) else float(value)
    except OverflowError:  # a whole number of hundreds of digits
        number = math.nan
    if not math.isfinite(number):
        raise CaptureError(f"{name}: {key} is not a number")
    return number


def _view(folder: Path, file: str, meta: dict, frame: dict, n: int, rescaled: list[str]) -> View:
    if not isinstance(frame.get("file_path"), str):
        raise CaptureError(f"frame {n} has no file_path")
    name = frame["file_path"]
    image = find_image(folder, name)
    if image is None:
        raise CaptureError(f"photo {name} is missing", f"Put it back into {folder}, or take its frame out of {file}.")
    check_readable(image, name)
    mask = None
    if frame.get("mask_path"):
        mask = find_image(folder, str(frame["mask_path"]))
        if mask is None:
            raise CaptureError(f"mask {frame['mask_path']} is missing", "Put it back, or take mask_path out of its frame.")
    return View(Path(name).stem, image, mask, fitted(_camera(meta, frame, name, image), image, name, file, rescaled))


def _camera(meta: dict, frame: dict, name: str, image: Path) -> Camera:
    width, height = _number(frame, meta, "w", name), _number(frame, meta, "h", name)
    if not width or not height:
        size = image_size(image)
        width, height = width or size[0], height or size[1]
    fl_x, angle = _number(frame, meta, "fl_x", name), _number(frame, meta, "camera_angle_x", name)
    if fl_x is None:
        if angle is None:
            raise CaptureError(f"{name} has no focal length", "Give fl_x in pixels, or camera_angle_x in radians.")
        if not 0 < angle < math.pi:
            raise CaptureError(f"{name}: camera_angle_x {angle:.4g} is not an angle between 0 and pi")
        fl_x = 0.5 * width / math.tan(0.5 * angle)
    fl_y, cx, cy = (_number(frame, meta, k, name) for k in ("fl_y", "cx", "cy"))
    fl_y, cx, cy = fl_y or fl_x, width / 2 if cx is None else cx, height / 2 if cy is None else cy
    if min(fl_x, fl_y) <= 0 or min(round(width), round(height)) < 1:
        raise CaptureError(f"{name}: focal length and size must be positive")
    return Camera(round(width), round(height), fl_x, fl_y, cx, cy, _matrix(frame, name), _lens(meta, frame, name))


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


def intrinsics_of(camera: Camera) -> dict[str, float | str]:
    """The keys of transforms.json for the camera's size, intrinsics [pixels] and lens, without terms that are 0."""
    terms = {name: getattr(camera.lens, name) for name in _TERMS}
    return {
        "camera_model": "OPENCV_FISHEYE" if camera.lens.fisheye else "OPENCV",
        "w": camera.width,
        "h": camera.height,
        "fl_x": camera.fl_x,
        "fl_y": camera.fl_y,
        "cx": camera.cx,
        "cy": camera.cy,
        **{name: value for name, value in terms.items() if value},
    }
