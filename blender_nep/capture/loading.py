"""Loading a capture: the format is chosen by what is in the folder, and what the files say is checked."""

from __future__ import annotations

import errno
import math
import os
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

import numpy as np

from blender_nep.capture.bounds import check_sphere, sphere_from_cameras, sphere_from_masks, stray_cameras
from blender_nep.capture.brackets import bracket_warnings
from blender_nep.capture.cameras.plausible_lens import lens_warnings
from blender_nep.capture.capture import Capture, View
from blender_nep.capture.description import MINIMUM_VIEWS, MOST_LACKING, CaptureDescription
from blender_nep.capture.formats import bundler, cameras_sphere, colmap, llff, metashape, nerf_synthetic, transforms
from blender_nep.capture.formats.peers import PEERS
from blender_nep.capture.mask_meaning import read_alpha, read_masks
from blender_nep.capture.photos.mask_files import MaskMeaning
from blender_nep.capture.photos.photo_files import is_linear
from blender_nep.capture.without_cameras import ARCHIVES, capture_around, is_video, no_capture, video_hint
from blender_nep.errors import CaptureError
from blender_nep.messages import Message

_OTHER_FORMATS = (nerf_synthetic, colmap, llff, cameras_sphere, metashape, bundler, *PEERS)
"""All formats but the first one, in the order in which they are asked"""


def load_capture(
    folder: Path | str,
    *,
    use_masks: bool = True,
    mask_meaning: MaskMeaning | None = None,
    file: str = transforms.FILE,
    sphere: tuple[Sequence[float], float] | None = None,
) -> Capture:
    """Read and check a capture. Photos are opened only for their size, and masks where the bounds need them.

    `file`: another file of the form of transforms.json in the folder, such as transforms_test.json. `sphere`: the object's
    (center [3], radius), which then counts instead of the file's. `use_masks` False: a missing sphere is estimated from the
    cameras alone. `mask_meaning`: what white in the masks means; None: as they look (mask_meaning.py). Raises CaptureError,
    BoundsError.
    """
    folder = Path(folder)
    said = describe(folder, file)
    photos = len(said.views)
    if photos < MINIMUM_VIEWS:
        raise CaptureError(
            f"{photos} photo{'s'[: photos - 1]}: at least {MINIMUM_VIEWS} from different places are needed",
            "20 and more photos all around the object work well.",
        )
    warnings = [warning for warning in said.warnings if use_masks or not warning.code.startswith("capture.masks_")]
    _check_places(said.views, warnings)
    warnings += bracket_warnings([v.image_path for v in said.views])
    warnings += lens_warnings([v.name for v in said.views], [v.camera for v in said.views])
    color_space = _color_space(said, warnings)
    capture = Capture(folder, said.views, color_space, np.zeros(3), 1.0, "", warnings, said.files, said.turntable)
    if sphere is None:
        _leave_strays_out(capture, said)
        _set_bounds(capture, said)
    else:
        capture.object_center, capture.object_radius = np.array(sphere[0], np.float64), float(sphere[1])
        capture.bounds_source = "options"
    if use_masks and said.missing_masks:
        first, more = said.missing_masks[0], len(said.missing_masks) - 1
        raise CaptureError(
            f"mask {first} is missing" + (f", and {more} more" if more else ""),
            "Put it back, or take mask_path out of its frame. --masks ignore leaves masks out.",
        )
    if use_masks:
        warnings += read_alpha(capture) if mask_meaning is None else []
        warnings += [] if capture.ignores_alpha else read_masks(capture, mask_meaning)
        if capture.bounds_source == "cameras":
            _shrink_to_masks(capture)
    cameras = [v.camera for v in capture.views]
    warnings += check_sphere([v.name for v in capture.views], cameras, capture.object_center, capture.object_radius)
    return capture


def recognized(folder: Path) -> bool:
    """Whether one of the formats recognizes the folder as a capture. A folder that may not be read is none."""
    try:
        return transforms.recognizes(folder) or any(other.recognizes(folder) for other in _OTHER_FORMATS)
    except OSError:
        return False


def describe(folder: Path, file: str = transforms.FILE) -> CaptureDescription:
    """What the folder's files say, read by the format that recognizes them. Raises CaptureError, BoundsError."""
    if not folder.exists():
        raise CaptureError(f"there is no folder {folder}", "Check the path of the capture.")
    if not folder.is_dir():
        if is_video(folder):
            message, values = f"{folder} is a video, and not a capture", {"folder": folder.parent, "video": folder.name}
            raise CaptureError(message, video_hint([folder]), "capture.video", **values)
        hint = "A capture is a folder with photos and their cameras."
        if recognized(folder.absolute().parent):
            hint += f" Name the folder: {folder.absolute().parent}"
        elif folder.name.lower().endswith(ARCHIVES):
            hint += " Unpack it first."
        raise CaptureError(f"{folder} is not a folder", hint)
    if not os.access(folder, os.R_OK | os.X_OK):
        reason = os.strerror(errno.EACCES)
        raise CaptureError(
            f"{folder} cannot be read ({reason})",
            "Change its permissions.",
            "capture.folder_unreadable",
            folder=folder,
            reason=reason,
        )
    if transforms.recognizes(folder, file):
        try:
            return transforms.read(folder, file)
        except CaptureError as error:
            if file == transforms.FILE and any(other.recognizes(folder) for other in _OTHER_FORMATS):
                error.hint += f" Or take {file} out of the folder: it also holds cameras of another form, which count then."
            raise
    if file == transforms.FILE:
        for other in _OTHER_FORMATS:
            if other.recognizes(folder):
                return _read(other, folder)
    raise no_capture(folder, file, recognized)


def _read(form: ModuleType, folder: Path) -> CaptureDescription:
    """What the format says of the folder. Raises CaptureError."""
    try:
        said: CaptureDescription = form.read(folder)
    except CaptureError as error:
        around = capture_around(folder, recognized)
        if around is not None and error.name == "capture.photos_not_there":
            error.hint = f"Name the whole capture: {around}"
        raise
    return said


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


def _color_space(said: CaptureDescription, warnings: list[Message]) -> str:
    """'linear' if the capture says so, or if the formats of all its photos do; else 'srgb'. Raises CaptureError."""
    declared = "srgb" if said.color_space is None else said.color_space
    declared = declared.lower() if isinstance(declared, str) else declared
    if declared not in ("linear", "srgb"):
        raise CaptureError(f"color_space {declared!r} is not known", "Use 'linear' or 'srgb'.")
    if declared == "linear" or all(is_linear(v.image_path) for v in said.views):
        space = "linear"
    else:
        space = "srgb"
    if (
        said.color_space is not None
        and declared == "srgb"
        and any(v.image_path.suffix.lower() == ".exr" for v in said.views)
    ):
        warnings.append(Message("capture.exr_is_linear"))
    return space


def _leave_strays_out(capture: Capture, said: CaptureDescription) -> None:
    """Leave out photos whose cameras stand where the others look, if they are few and the files say no sphere.

    Programs write an identity matrix for a photo whose place they have not found.
    """
    if said.object_center is not None and said.object_radius is not None:
        return
    strays = stray_cameras([view.camera for view in capture.views])
    if strays and len(capture.views) - len(strays) >= MINIMUM_VIEWS:
        names = [capture.views[i].name for i in strays]
        capture.views = [view for i, view in enumerate(capture.views) if i not in strays]
        capture.warnings.append(Message("capture.cameras_in_object", {"count": len(names), "names": names}))


def _set_bounds(capture: Capture, said: CaptureDescription) -> None:
    """The object's sphere: as the files say, else estimated from the cameras."""
    center, radius = said.object_center, said.object_radius
    cameras = [v.camera for v in capture.views]
    if center is not None and radius is not None:
        try:
            capture.object_center, capture.object_radius = np.array(center, np.float64), float(radius)
        except (TypeError, ValueError):
            capture.object_center = np.zeros(0)
        good = capture.object_center.shape == (3,) and np.isfinite(capture.object_center).all()
        if not good or not math.isfinite(capture.object_radius) or capture.object_radius <= 0:
            raise CaptureError("object_center must be three numbers and object_radius a positive one")
        capture.bounds_source = said.name
        return
    if (center is None) != (radius is None):
        capture.warnings.append(Message("capture.half_a_sphere"))
    capture.object_center, capture.object_radius = sphere_from_cameras(cameras)
    capture.bounds_source = "cameras"


def _shrink_to_masks(capture: Capture) -> None:
    """The object's sphere as the masks show it, where nearly every photo has one and they agree."""
    wanted = range(len(capture.views)) if _may_have_masks(capture) else range(0)
    found = {i: mask for i in wanted if (mask := _coarse_mask(capture, i)) is not None}
    showing = {i: mask for i, mask in found.items() if not (mask > 0.5).all()}  # a white mask is one that failed
    if 2 * len(showing) < len(found):
        showing = found
    cameras, masks = [capture.views[i].camera for i in showing], list(showing.values())
    if len(found) >= max(MINIMUM_VIEWS, (1 - MOST_LACKING) * len(capture.views)):
        sphere = sphere_from_masks(cameras, masks, capture.object_center, capture.object_radius)
        if sphere is None:
            capture.warnings.append(Message("capture.masks_disagree"))
            return
        nearest = min(float(np.linalg.norm(view.camera.position - sphere[0])) for view in capture.views)
        capture.object_center, capture.object_radius = sphere[0], min(sphere[1], 0.9 * nearest)
        capture.bounds_source = "masks"


def _may_have_masks(capture: Capture) -> bool:
    return any(v.mask_path for v in capture.views) or _coarse_mask(capture, 0) is not None


def _coarse_mask(capture: Capture, i: int) -> np.ndarray | None:
    """Every n-th pixel of the mask of photo `i`, so that 200 to 400 are left along the longer side; None without a mask."""
    camera = capture.views[i].camera
    sides = camera.width, camera.height
    return capture.load_mask(i, max(1, min(max(sides) // 200, min(sides))))
