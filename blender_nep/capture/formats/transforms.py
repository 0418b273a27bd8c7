"""Reads `transforms.json`, the format of instant-ngp and nerfstudio.

Optional keys are added: `object_center`, `object_radius`, `color_space`; `turntable`, with `row` and `turn` in the frames.
`cameras/lens_keys.py` reads the intrinsics and the lens, which stand at the top or in a frame.
"""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from blender_nep.capture.cameras.camera import Camera
from blender_nep.capture.cameras.conventions import MITSUBA, OPENGL, read_poses
from blender_nep.capture.cameras.lens_keys import LensKeys
from blender_nep.capture.cameras.photo_agreement import PhotoAgreement
from blender_nep.capture.capture import View
from blender_nep.capture.description import MINIMUM_VIEWS, CaptureDescription, check_number
from blender_nep.capture.formats.mask_search import with_masks
from blender_nep.capture.formats.photo_search import photos_named
from blender_nep.capture.formats.photos import check_readable, fitted, rescaled_warnings
from blender_nep.capture.formats.poses import without_pose_warnings
from blender_nep.capture.photos.photo_files import image_size, refuse_other_computer
from blender_nep.capture.photos.photo_lookup import PLACES, PhotoLookup, stem
from blender_nep.errors import CaptureError
from blender_nep.messages import Message
from blender_nep.safety.plain_files import read_json

FILE = "transforms.json"
_MASK_PLACES = ("", "masks", "mask")
"""Folders of masks in the folder of a capture that was moved"""


def recognizes(folder: Path, file: str = FILE) -> bool:
    """Whether the folder holds a capture of this format."""
    return (folder / file).is_file()


def read(folder: Path, file: str = FILE) -> CaptureDescription:
    """What the file says; photos are opened only for their size. Raises CaptureError."""
    meta = _read_json(folder / file)
    frames = meta.get("frames")
    if not isinstance(frames, list) or not frames:
        raise CaptureError(f"{file} lists no frames", "It needs a list 'frames' with file_path and transform_matrix.")
    check_number(len(frames), file)
    named = [(_photo_name(frame, n), frame) for n, frame in enumerate(frames)]
    photos, warnings = photos_named(folder, [name for name, _ in named], file, PLACES, absolute_first=True)
    named, without = _with_pose([(name, frame) for name, frame in named if name in photos])
    named, twice = _once(named, photos, file)
    warnings += without + twice
    cameras, more = _cameras(meta, named, photos)
    rescaled: list[str] = []
    turned: list[str] = []
    places = _places_on_turntable(named, strict=meta.get("turntable") is not False)
    views, lookup = [], PhotoLookup(folder)
    missing_masks: list[str] = []
    for (name, frame), camera in zip(named, cameras, strict=True):
        image, mask = photos[name], _mask(lookup, frame, missing_masks)
        camera = fitted(camera, image, name, file, rescaled, turned)
        views.append(View(stem(image.name), image, mask, camera, *places[name]))
    views, found = with_masks(folder, views, named_by_file=True)
    return CaptureDescription(
        name=file,
        files=(folder / file,),
        views=views,
        color_space=meta.get("color_space"),
        object_center=meta.get("object_center"),
        object_radius=meta.get("object_radius"),
        turntable=_turntable(meta, named),
        warnings=warnings + more + found + rescaled_warnings(rescaled, turned),
        missing_masks=missing_masks,
    )


def _read_json(path: Path) -> dict:
    try:
        meta = read_json(path, None)
    except (OSError, ValueError) as error:
        raise CaptureError(
            f"{path.name} cannot be read ({error})",
            "It must be JSON: no comments, no comma after a last entry, nothing missing at its end.",
        ) from error
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


def _with_pose(named: list[tuple[str, dict]]) -> tuple[list[tuple[str, dict]], list[Message]]:
    """The frames that have a pose, and a warning about the others. Programs write NaN, null or zeros where they find none.

    If too few frames have one, all are kept: their reader says what is wrong.
    """
    blank = [_is_blank(frame.get("transform_matrix")) for _, frame in named]
    if not any(blank) or blank.count(False) < MINIMUM_VIEWS:
        return named, []
    without = [name for (name, _), none in zip(named, blank, strict=True) if none]
    return [one for one, none in zip(named, blank, strict=True) if not none], without_pose_warnings(without)


def _is_blank(value: object) -> bool:
    """Whether a matrix says that there is no pose."""
    if value is None:
        return True
    try:
        matrix = np.array(value, np.float64)
    except (TypeError, ValueError, OverflowError):
        return False
    return matrix.size in (12, 16) and not (np.isfinite(matrix).all() and matrix.ravel()[:12].any())


def _once(named: list[tuple[str, dict]], photos: dict[str, Path], file: str) -> tuple[list[tuple[str, dict]], list[Message]]:
    """The first frame of each photo, and a warning about equal ones. Raises CaptureError where two poses differ."""
    first: dict[Path, dict] = {}
    kept, again = [], []
    for name, frame in named:
        known = first.setdefault(photos[name], frame)
        if known is frame:
            kept.append((name, frame))
        elif known.get("transform_matrix") == frame.get("transform_matrix"):
            again.append(name)
        else:
            raise CaptureError(f"{file} has several cameras for {photos[name].name}", "Leave one frame of each photo.")
    return kept, [Message("capture.frames_twice", {"count": len(again), "names": again})] if again else []


def _cameras(meta: dict, named: list[tuple[str, dict]], photos: dict[str, Path]) -> tuple[list[Camera], list[Message]]:
    """The cameras of the frames, with the sizes that the file says, and what was not as it should be."""
    cameras, matrices = [], []
    odd_angles: list[str] = []
    for name, frame in named:
        image = photos[name]
        check_readable(image, name)
        parts = LensKeys(meta, frame, name).camera_parts(partial(image_size, image), odd_angles)
        cameras.append(Camera(camera_to_world=np.eye(4), **parts))
        matrices.append(_matrix(frame, name))
    warnings = []
    if odd_angles:
        warnings.append(Message("capture.angles_disagree", {"count": len(odd_angles), "names": odd_angles}))
    names = [name for name, _ in named]
    poses, told = read_poses(
        np.stack(matrices),
        cameras,
        names,
        PhotoAgreement([photos[name] for name in names]),
        given_axes=MITSUBA if meta.get("from_mitsuba") else OPENGL,
        place=_place(meta),
    )
    cameras = [replace(camera, camera_to_world=pose) for camera, pose in zip(cameras, poses, strict=True)]
    return cameras, warnings + told


def _place(meta: dict) -> np.ndarray | None:
    """The object's center [3] that the file says; None where it says none, or no usable one."""
    try:
        place = np.array(meta.get("object_center"), np.float64)
    except (TypeError, ValueError, OverflowError):
        return None
    return place if place.shape == (3,) and np.isfinite(place).all() else None


def _turntable(meta: dict, named: list[tuple[str, dict]]) -> bool | None:
    """Whether the object turned on a turntable; None: the file does not say. Raises CaptureError."""
    said = meta.get("turntable")
    if said is not None and not isinstance(said, bool):
        raise CaptureError(f"turntable is {said!r}", "It must be true or false.")
    for key in () if said is False else ("row", "turn"):
        missing = [name for name, frame in named if frame.get(key) is None]
        if 0 < len(missing) < len(named):
            raise CaptureError(
                f"{missing[0]} has no {key}, but other frames have one", "Give it for all frames, or for none."
            )
    return said


def _places_on_turntable(named: list[tuple[str, dict]], strict: bool) -> dict[str, tuple[int | None, float | None]]:
    """{name: row and turn}. Where the object did not turn (not `strict`), they count only if the user says otherwise.

    Then wrong values, or those of a part of the frames, are passed over. Raises CaptureError where `strict`.
    """
    try:
        found = {name: _place_on_turntable(frame, name) for name, frame in named}
    except CaptureError:
        if strict:
            raise
        return {name: (None, None) for name, _ in named}
    if strict:
        return found
    has_row, has_turn = (all(place[k] is not None for place in found.values()) for k in (0, 1))
    return {name: (row if has_row else None, turn if has_turn else None) for name, (row, turn) in found.items()}


def _place_on_turntable(frame: dict, name: str) -> tuple[int | None, float | None]:
    """The frame's row, and the table's angle in degrees; None where the file does not say it. Raises CaptureError."""
    row, turn = frame.get("row"), frame.get("turn")
    if row is not None and (not isinstance(row, int) or isinstance(row, bool) or row < 0):
        raise CaptureError(f"{name}: row is {row!r}", "It must be a whole number: 0 for the first place of the camera.")
    if turn is None:
        return row, None
    if isinstance(turn, bool) or not isinstance(turn, int | float) or not math.isfinite(turn):
        raise CaptureError(f"{name}: turn is {turn!r}", "It must be the table's angle in degrees.")
    return row, float(turn)


def _mask(lookup: PhotoLookup, frame: dict, missing: list[str]) -> Path | None:
    """The mask that the frame names. If that is not there, its name is added to `missing`."""
    if not frame.get("mask_path"):
        return None
    named = str(frame["mask_path"])
    refuse_other_computer(lookup.folder, named)
    mask = lookup.find(named, _MASK_PLACES)
    if mask is None:
        missing.append(named)
    return mask


def _matrix(frame: dict, name: str) -> np.ndarray:
    """The frame's matrix [4, 4] as the file has it, divided by its last number. Raises CaptureError if it is no matrix."""
    try:
        matrix = np.array(frame.get("transform_matrix"), np.float64)
    except (TypeError, ValueError, OverflowError):
        matrix = np.zeros(0)
    if matrix.shape in ((16,), (12,)):
        matrix = matrix.reshape(-1, 4)
    if matrix.shape == (3, 4):
        matrix = np.concatenate([matrix, [[0.0, 0.0, 0.0, 1.0]]])
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
        raise CaptureError(f"{name}: transform_matrix is not a 4 x 4 matrix of numbers")
    return matrix / matrix[3, 3] if matrix[3, 3] > 0 else matrix
