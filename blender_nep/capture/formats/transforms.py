"""Reads `transforms.json`, the format of instant-ngp and nerfstudio.

Three optional keys are added: `object_center`, `object_radius` and `color_space`. The intrinsics `fl_x fl_y cx cy w h` stand
at the top or in a frame. Where `fl_x` is missing, `camera_angle_x` (radians) gives it.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from blender_nep.capture.bounds import check_sphere, sphere_from_cameras, sphere_from_masks
from blender_nep.capture.camera import Camera
from blender_nep.capture.capture import Capture, View
from blender_nep.capture.photo_files import SUFFIXES, find_image, image_size
from blender_nep.errors import CaptureError
from blender_nep.messages import Message

MINIMUM_VIEWS = 3
"""With fewer photos, neither the shape nor the surroundings are determined: two views cannot even contradict each other."""

_PINHOLE = ("PINHOLE", "SIMPLE_PINHOLE", "OPENCV", "PERSPECTIVE", "SIMPLE_RADIAL", "RADIAL")


def load_capture(
    folder: Path | str,
    *,
    use_masks: bool = True,
    transforms: str = "transforms.json",
    sphere: tuple[Sequence[float], float] | None = None,
) -> Capture:
    """Read and check a capture. Only the headers of photos are read; masks are read only if the sphere needs them.

    `sphere` is the object's (centre [3], radius) in capture units; it replaces the sphere of the file. With `use_masks`
    False, a missing sphere is estimated from the cameras alone. Raises CaptureError, BoundsError.
    """
    folder = Path(folder)
    meta = _read_json(folder, transforms)
    warnings: list[Message] = []
    frames = meta.get("frames")
    if not isinstance(frames, list) or not frames:
        raise CaptureError(f"{transforms} lists no frames", "It needs a list 'frames' with file_path and transform_matrix.")
    if len(frames) < MINIMUM_VIEWS:
        raise CaptureError(
            f"{len(frames)} photo{'s'[: len(frames) - 1]}: at least {MINIMUM_VIEWS} from different places are needed",
            "20 and more photos all around the object work well.",
        )
    _check_lens(meta, frames, warnings)
    rescaled: list[str] = []
    views = [_view(folder, meta, frame, n, rescaled) for n, frame in enumerate(frames)]
    if rescaled:
        warnings.append(Message("capture.photos_rescaled", {"count": len(rescaled), "names": rescaled}))
    _check_places(views, warnings)
    color_space = _color_space(meta, views, warnings)
    capture = Capture(folder, views, color_space, np.zeros(3), 1.0, "", warnings)
    if sphere is None:
        _set_bounds(capture, meta, use_masks)
    else:
        capture.object_center, capture.object_radius = np.array(sphere[0], np.float64), float(sphere[1])
        capture.bounds_source = "options"
    cameras = [v.camera for v in views]
    warnings += check_sphere([v.name for v in views], cameras, capture.object_center, capture.object_radius)
    return capture


def _read_json(folder: Path, name: str) -> dict:
    if not folder.exists():
        raise CaptureError(f"there is no folder {folder}", "Check the path of the capture.")
    if not folder.is_dir():
        raise CaptureError(f"{folder} is not a folder", "A capture is a folder with transforms.json and photos.")
    path = folder / name
    if not path.is_file():
        state = "is empty" if not any(folder.iterdir()) else f"has no {name}"
        raise CaptureError(f"{folder} {state}", f"A capture is a folder with {name} and photos.")
    try:
        meta = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise CaptureError(f"{name} cannot be read ({error})", "It must be JSON text.") from error
    if not isinstance(meta, dict):
        raise CaptureError(f"{name} does not hold a JSON object")
    return meta


def _check_lens(meta: dict, frames: list[dict], warnings: list[Message]) -> None:
    models = {
        str(m).upper()
        for m in [meta.get("camera_model")] + [_dict(f, n).get("camera_model") for n, f in enumerate(frames)]
        if m
    }
    unknown = sorted(models - set(_PINHOLE))
    if unknown:
        raise CaptureError(f"camera model {unknown[0]} is not supported", "Undistort the photos to PINHOLE first.")
    terms = [s.get(k, 0) for s in [meta, *frames] for k in ("k1", "k2", "k3", "k4", "p1", "p2")]
    if any(abs(t) > 1e-4 for t in terms if isinstance(t, int | float)):
        warnings.append(Message("capture.lens_ignored"))


def _dict(frame: object, n: int) -> dict:
    if not isinstance(frame, dict):
        raise CaptureError(f"frame {n} is not a JSON object")
    return frame


def _number(frame: dict, meta: dict, key: str, name: str) -> float | None:
    value = frame.get(key, meta.get(key))
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise CaptureError(f"{name}: {key} is not a number")
    return float(value)


def _view(folder: Path, meta: dict, frame: dict, n: int, rescaled: list[str]) -> View:
    if not isinstance(frame.get("file_path"), str):
        raise CaptureError(f"frame {n} has no file_path")
    name = frame["file_path"]
    image = find_image(folder, name)
    if image is None:
        raise CaptureError(
            f"photo {name} is missing", f"Put it back into {folder}, or take its frame out of transforms.json."
        )
    if image.suffix.lower() not in SUFFIXES:
        raise CaptureError(f"{name}: only {', '.join(s[1:] for s in SUFFIXES)} photos can be read", "Convert the photos.")
    mask = None
    if frame.get("mask_path"):
        mask = find_image(folder, str(frame["mask_path"]))
        if mask is None:
            raise CaptureError(f"mask {frame['mask_path']} is missing", "Put it back, or take mask_path out of its frame.")
    return View(Path(name).stem, image, mask, _camera(meta, frame, name, image_size(image), rescaled))


def _camera(meta: dict, frame: dict, name: str, size: tuple[int, int], rescaled: list[str]) -> Camera:
    width, height = _number(frame, meta, "w", name) or size[0], _number(frame, meta, "h", name) or size[1]
    fl_x, angle = _number(frame, meta, "fl_x", name), _number(frame, meta, "camera_angle_x", name)
    if fl_x is None:
        if angle is None:
            raise CaptureError(f"{name} has no focal length", "Give fl_x in pixels, or camera_angle_x in radians.")
        if not 0 < angle < math.pi:
            raise CaptureError(f"{name}: camera_angle_x {angle:.4g} is not an angle between 0 and pi")
        fl_x = 0.5 * width / math.tan(0.5 * angle)
    fl_y, cx, cy = (_number(frame, meta, k, name) for k in ("fl_y", "cx", "cy"))
    fl_y, cx, cy = fl_y or fl_x, width / 2 if cx is None else cx, height / 2 if cy is None else cy
    if min(fl_x, fl_y, width, height) <= 0:
        raise CaptureError(f"{name}: focal length and size must be positive")
    camera = Camera(round(width), round(height), fl_x, fl_y, cx, cy, _matrix(frame, name))
    if (camera.width, camera.height) == size:
        return camera
    if abs(size[0] * height / (size[1] * width) - 1) > 0.01:
        raise CaptureError(
            f"{name} is {size[0]} x {size[1]} pixels, but transforms.json says {camera.width} x {camera.height}",
            "The aspect differs, so the intrinsics cannot be rescaled: correct w and h, or the photo.",
        )
    rescaled.append(name)
    return camera.scaled(*size)


def _matrix(frame: dict, name: str) -> np.ndarray:
    """The frame's camera-to-world matrix [4, 4], with its rotation made exactly orthonormal.

    Raises CaptureError if the matrix is missing, scales, shears or mirrors.
    """
    try:
        matrix = np.array(frame.get("transform_matrix"), np.float64)
    except (TypeError, ValueError):
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


def _check_places(views: list[View], warnings: list[Message]) -> None:
    """Raises CaptureError when the photos were taken from fewer than MINIMUM_VIEWS places.

    Adds a warning when several photos have the same place and direction.
    """
    places = np.stack([v.camera.position for v in views])
    spread = np.linalg.norm(places - places[0], axis=1).max()
    # The limit is relative to the coordinates: a small scene far from the origin is allowed, down to float64's last digits.
    if spread <= 1e-10 * np.abs(places).max():
        raise CaptureError("all cameras stand at the same place", "Photos from around the object are needed.")
    turns = np.stack([v.camera.camera_to_world[:3, :3].ravel() for v in views])
    cell = np.round(1e6 * np.concatenate([(places - places[0]) / spread, turns], 1)).astype(np.int64)
    if len(np.unique(cell[:, :3], axis=0)) < MINIMUM_VIEWS:
        raise CaptureError(
            "the photos were taken from only 2 different places",
            f"At least {MINIMUM_VIEWS} places are needed; 20 and more all around the object work well.",
        )
    _, first = np.unique(cell, axis=0, return_index=True)
    again = [views[i].name for i in sorted(set(range(len(views))) - set(first.tolist()))]
    if again:
        warnings.append(Message("capture.same_place", {"count": len(again), "names": again}))


def _color_space(meta: dict, views: list[View], warnings: list[Message]) -> str:
    exr = [v.image_path.suffix.lower() == ".exr" for v in views]
    declared = meta.get("color_space", "linear" if all(exr) else "srgb")
    if declared not in ("linear", "srgb"):
        raise CaptureError(f"color_space {declared!r} is not known", "Use 'linear' or 'srgb'.")
    if declared == "srgb" and any(exr):
        warnings.append(Message("capture.exr_is_linear"))
        return "linear" if all(exr) else "srgb"
    return declared


def _set_bounds(capture: Capture, meta: dict, use_masks: bool) -> None:
    center, radius = meta.get("object_center"), meta.get("object_radius")
    cameras = [v.camera for v in capture.views]
    if center is not None and radius is not None:
        try:
            capture.object_center, capture.object_radius = np.array(center, np.float64), float(radius)
        except (TypeError, ValueError):
            capture.object_center = np.zeros(0)
        good = capture.object_center.shape == (3,) and np.isfinite(capture.object_center).all()
        if not good or not math.isfinite(capture.object_radius) or capture.object_radius <= 0:
            raise CaptureError("object_center must be three numbers and object_radius a positive one")
        capture.bounds_source = "transforms.json"
        return
    if (center is None) != (radius is None):
        capture.warnings.append(Message("capture.half_a_sphere"))
    capture.object_center, capture.object_radius = sphere_from_cameras(cameras)
    capture.bounds_source = "cameras"
    wanted = range(len(cameras)) if use_masks and _may_have_masks(capture) else range(0)
    masks = [mask for i in wanted if (mask := _coarse(capture.load_mask(i))) is not None]
    if len(masks) == len(cameras):
        sphere = sphere_from_masks(cameras, masks, capture.object_center, capture.object_radius)
        if sphere is None:
            capture.warnings.append(Message("capture.masks_disagree"))
            return
        nearest = min(float(np.linalg.norm(c.position - sphere[0])) for c in cameras)
        capture.object_center, capture.object_radius = sphere[0], min(sphere[1], 0.9 * nearest)
        capture.bounds_source = "masks"


def _may_have_masks(capture: Capture) -> bool:
    return all(v.mask_path for v in capture.views) or capture.load_mask(0) is not None


def _coarse(mask: np.ndarray | None) -> np.ndarray | None:
    """Every n-th pixel of the mask, so that 200 to 400 are left along the longer side. None stays None."""
    step = 1 if mask is None else max(1, max(mask.shape) // 200)
    return None if mask is None else mask[step // 2 :: step, step // 2 :: step]
