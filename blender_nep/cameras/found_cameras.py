"""Says how well the cameras of photos were found, and turns them into an upright frame around the object."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from blender_nep.cameras.alignment import moved
from blender_nep.cameras.photo_folder import Photo
from blender_nep.cameras.structure_from_motion import Group, PlacedPhoto
from blender_nep.cameras.ways import LEAST, LONGEST_SIDE, WAYS, enough
from blender_nep.capture.bounds import sphere_from_cameras
from blender_nep.capture.cameras.upright import upward
from blender_nep.capture.loading import MINIMUM_VIEWS
from blender_nep.errors import CaptureError
from blender_nep.messages import Message

_FEW_POINTS = 60
"""A photo with fewer scene points is unsure."""
_LARGE_ERROR = 2.0
"""Pixels of a photo scaled down to LONGEST_SIDE. A photo with a larger error is unsure."""
_OUTLIER, _SMALL_ERROR = 3.0, 0.5
"""A photo whose error is so many times the median, and more than so many of the same pixels, is unsure, too. A zoomed photo
has such an error where EXIF does not tell its focal length."""
_GAP = 60.0
"""Degrees around the object without a photo that deserve a warning"""
_PATTERN = (
    "Put the object on a sheet with a print (a newspaper, a patterned cloth), let things stand around it, and take 40 "
    "photos or more that overlap by two thirds."
)

_NO_EXIF = "These photos have no EXIF. If the lens was zoomed, use the camera's own files, which tell the focal length."
_NO_FOCAL_LENGTH = "EXIF of these photos does not tell the focal length. If the lens was zoomed, use the camera's own files."


@dataclass(frozen=True)
class FoundCameras:
    """Cameras of some of the photos."""

    placed: list[PlacedPhoto]
    points: np.ndarray
    """[n, 3] scene points"""
    not_placed: list[Photo]
    object_center: np.ndarray = field(default_factory=lambda: np.zeros(3))
    object_radius: float = 1.0
    turntable: bool | None = None
    """Whether the object turned while the camera and the surroundings stood still. None: that is not known"""

    @property
    def median_error(self) -> float:
        """Median distance [pixels] between features and the projections of their scene points"""
        return float(np.median([found.error for found in self.placed]))


def choose(photos: Sequence[Photo], groups: Sequence[Group]) -> FoundCameras:
    """The largest group, in a frame with z up, the object's center at 0, and the object's sphere of radius 1.

    Raises CaptureError where too few photos were placed: less than `LEAST`.
    """
    count = len(groups[0].placed) if groups else 0
    names = {found.photo.path for found in groups[0].placed} if groups else set()
    left = [photo for photo in photos if photo.path not in names]
    if count < MINIMUM_VIEWS or count < LEAST * len(photos):
        raise _not_found(count, photos, [photo.path.name for photo in left])
    best = groups[0]
    turn = _upright([found.photo for found in best.placed], [found.camera.camera_to_world for found in best.placed])
    center, radius = sphere_from_cameras([moved(found.camera, turn, 1.0, np.zeros(3)) for found in best.placed])
    placed = [found.moved(turn, 1 / radius, -center / radius) for found in best.placed]
    return FoundCameras(placed, (best.points @ turn.T - center) / radius, left)


def _not_found(count: int, photos: Sequence[Photo], missing: Sequence[str]) -> CaptureError:
    """The error where only `count` of the photos were placed; `missing`: names of the others."""
    few = f"only {count} of {len(photos)} photos could be placed" if count else "no photo could be placed"
    hint = _PATTERN
    if not any(photo.has_exif for photo in photos):
        hint += f" {_NO_EXIF}"
    elif not any(any(photo.camera) for photo in photos):
        hint += f" {_NO_FOCAL_LENGTH}"
    if count >= MINIMUM_VIEWS:
        hint += f" If the other photos show the whole object, take these out of the folder: {', '.join(missing)}."
    why = "the photos share too few points, or were taken from one place"
    return CaptureError(
        f"{few}: {why}", hint, "capture.cameras_not_found", placed=count, photos=len(photos), names=list(missing)
    )


def _upright(photos: Sequence[Photo], poses: Sequence[np.ndarray]) -> np.ndarray:
    """The rotation [3, 3] that turns the photos' common upward direction to +z."""
    axes = []
    for photo, pose in zip(photos, poses, strict=True):
        right, up = pose[:3, 0], pose[:3, 1]
        for _ in range(photo.quarter_turns):  # the stored image is turned clockwise to stand upright
            right, up = up, -right
        axes.append((right, up))
    rights, above = (np.stack(part) for part in zip(*axes, strict=True))
    z = upward(rights, above)
    x = rights[0] - z * (rights[0] @ z)
    x = x / max(float(np.linalg.norm(x)), 1e-12)
    return np.stack([x, np.cross(z, x), z])


def messages(found: FoundCameras, groups: Sequence[Group]) -> tuple[list[Message], list[Message]]:
    """(what was found, warnings) in words."""
    total = len(found.placed) + len(found.not_placed)
    said = [
        Message("cameras.placed", {"count": len(found.placed), "photos": total, "error": found.median_error}),
    ]
    way = WAYS[groups[0].way]
    if way.found is not None:
        said.append(way.found)
    warnings = []
    names = [photo.path.name for photo in found.not_placed]
    if len(found.placed) < enough(total):
        values = {"count": len(found.placed), "photos": total, "list": ", ".join(names)}  # all of them: not shortened
        warnings.append(Message("cameras.many_not_placed", values))
    elif names:
        warnings.append(Message("cameras.not_placed", {"count": len(names), "names": names}))
    others = [len(group.placed) for group in groups[1:] if len(group.placed) >= MINIMUM_VIEWS]
    if others and found.not_placed:
        warnings.append(Message("cameras.groups", {"count": len(others) + 1}))
    unsure = _unsure(found.placed)
    if unsure:
        warnings.append(Message("cameras.unsure", {"count": len(unsure), "names": unsure}))
    gap, before, after = _largest_gap(found.placed)
    if gap > _GAP:
        warnings.append(Message("cameras.gap", {"degrees": gap, "before": before, "after": after}))
    if not warnings:
        said.append(Message("cameras.sure"))
    return said, warnings


def _unsure(placed: Sequence[PlacedPhoto]) -> list[str]:
    """Names of the photos whose cameras may be wrong."""
    usual = float(np.median([found.error / _reduction(found) for found in placed]))
    limit = min(_LARGE_ERROR, max(_OUTLIER * usual, _SMALL_ERROR))
    cameras = Counter(found.photo.camera for found in placed)
    shapes = Counter(_shape(found.photo) for found in placed)
    unsure = []
    for found in placed:
        # the center of a lens is taken for the center of the photo, which is wrong where a photo was cropped
        cropped = shapes[_shape(found.photo)] == 1 and cameras[found.photo.camera] > 1
        if found.points < _FEW_POINTS or found.error > limit * _reduction(found) or cropped:
            unsure.append(found.photo.path.name)
    return unsure


def _shape(photo: Photo) -> tuple[object, ...]:
    """The camera as EXIF names it, and the ratio of the photo's longer side to the shorter one."""
    return (*photo.camera, round(max(photo.width, photo.height) / min(photo.width, photo.height), 2))


def _reduction(found: PlacedPhoto) -> float:
    """How many pixels of the photo are one pixel of its copy for structure from motion."""
    return max(1.0, max(found.photo.width, found.photo.height) / LONGEST_SIDE)


def _largest_gap(placed: Sequence[PlacedPhoto]) -> tuple[float, str, str]:
    """The largest angle [degrees] around the vertical axis without a photo, and the photos on its two sides."""
    place = np.stack([found.camera.position for found in placed])
    angle = np.degrees(np.arctan2(place[:, 1], place[:, 0]))
    order = np.argsort(angle, kind="stable")
    gaps = np.diff(np.append(angle[order], angle[order[0]] + 360))
    largest = int(gaps.argmax())
    names = [placed[i].photo.path.name for i in (order[largest], order[(largest + 1) % len(order)])]
    return float(gaps[largest]), names[0], names[1]
