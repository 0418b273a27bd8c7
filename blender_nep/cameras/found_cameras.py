"""Says how well the cameras of photos were found, and turns them into an upright frame around the object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from blender_nep.cameras.photo_folder import Photo
from blender_nep.cameras.structure_from_motion import LONGEST_SIDE, Group, PlacedPhoto
from blender_nep.capture.bounds import sphere_from_cameras
from blender_nep.capture.loading import MINIMUM_VIEWS
from blender_nep.errors import CaptureError
from blender_nep.messages import Message

_ENOUGH = 20
"""So many placed photos are enough to go on, even if they are less than half of all."""
_FEW_POINTS = 60
"""A photo with fewer scene points is unsure."""
_LARGE_ERROR = 2.0
"""Pixels of a photo scaled down to LONGEST_SIDE. A photo with a larger error is unsure."""
_GAP = 60.0
"""Degrees around the object without a photo that deserve a warning"""
_PATTERN = (
    "Put the object on a sheet with a print (a newspaper, a patterned cloth), let things stand around it, and take 40 "
    "photos or more that overlap by two thirds."
)


@dataclass(frozen=True)
class FoundCameras:
    """Cameras of some of the photos. The frame has z up, the object's center at 0, and the object's sphere has radius 1."""

    placed: list[PlacedPhoto]
    points: np.ndarray
    """[n, 3] scene points"""
    not_placed: list[Photo]

    @property
    def median_error(self) -> float:
        """Median distance [pixels] between features and the projections of their scene points"""
        return float(np.median([found.error for found in self.placed]))


def choose(photos: Sequence[Photo], groups: Sequence[Group]) -> FoundCameras:
    """The largest group, turned upright and scaled. Raises CaptureError where too few photos were placed."""
    count = len(groups[0].placed) if groups else 0
    if count < MINIMUM_VIEWS or (2 * count < len(photos) and count < _ENOUGH):
        placed = f"only {count} of {len(photos)} photos could be placed" if count else "no photo could be placed"
        raise CaptureError(f"{placed}: the photos share too few points", _PATTERN, "capture.cameras_not_found", placed=count)
    best = groups[0]
    turn = _upright([found.photo for found in best.placed], [found.camera.camera_to_world for found in best.placed])
    turned = [replace(f, camera=_moved(f.camera, turn, np.zeros(3), 1.0)) for f in best.placed]
    center, radius = sphere_from_cameras([found.camera for found in turned])
    moved = [replace(f, camera=_moved(f.camera, np.eye(3), center, radius)) for f in turned]
    names = {found.photo.path for found in best.placed}
    left = [photo for photo in photos if photo.path not in names]
    return FoundCameras(moved, (best.points @ turn.T - center) / radius, left)


def _moved(camera, turn: np.ndarray, center: np.ndarray, scale: float):
    matrix = camera.camera_to_world.copy()
    matrix[:3, :3] = turn @ matrix[:3, :3]
    matrix[:3, 3] = (turn @ matrix[:3, 3] - center) / scale
    return replace(camera, camera_to_world=matrix)


def _upright(photos: Sequence[Photo], poses: Sequence[np.ndarray]) -> np.ndarray:
    """The rotation [3, 3] that turns the photos' common upward direction to +z.

    People hold a camera level, so the upward direction is the one to which the horizontal axes of all cameras are most
    perpendicular. The mean of the cameras' own upward axes gives its sign. That mean alone serves where all cameras look
    along one line.
    """
    axes = []
    for photo, pose in zip(photos, poses, strict=True):
        right, up = pose[:3, 0], pose[:3, 1]
        for _ in range(photo.quarter_turns):  # the stored image is turned clockwise to stand upright
            right, up = up, -right
        axes.append((right, up))
    rights, mean = np.stack([right for right, _ in axes]), np.mean([up for _, up in axes], axis=0)
    values, vectors = np.linalg.eigh(rights.T @ rights / len(rights))
    up = vectors[:, 0] if values[1] > 4 * values[0] else mean
    up = up * (np.sign(up @ mean) or 1.0)
    z = up / max(float(np.linalg.norm(up)), 1e-12)
    x = rights[0] - z * (rights[0] @ z)
    x = x / max(float(np.linalg.norm(x)), 1e-12)
    return np.stack([x, np.cross(z, x), z])


def messages(found: FoundCameras, groups: Sequence[Group]) -> tuple[list[Message], list[Message]]:
    """(what was found, warnings) in words."""
    total = len(found.placed) + len(found.not_placed)
    said = [
        Message("cameras.placed", {"count": len(found.placed), "photos": total, "error": found.median_error}),
    ]
    warnings = []
    if found.not_placed:
        names = [photo.path.name for photo in found.not_placed]
        warnings.append(Message("cameras.not_placed", {"count": len(names), "names": names}))
    others = [len(group.placed) for group in groups[1:] if len(group.placed) >= MINIMUM_VIEWS]
    if others and found.not_placed:
        warnings.append(Message("cameras.groups", {"count": len(others) + 1}))
    unsure = [f.photo.path.name for f in found.placed if f.points < _FEW_POINTS or f.error > _LARGE_ERROR * _reduction(f)]
    if unsure:
        warnings.append(Message("cameras.unsure", {"count": len(unsure), "names": unsure}))
    gap, before, after = _largest_gap(found.placed)
    if gap > _GAP:
        warnings.append(Message("cameras.gap", {"degrees": gap, "before": before, "after": after}))
    if not warnings:
        said.append(Message("cameras.sure"))
    return said, warnings


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
