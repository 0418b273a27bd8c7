"""Takes over cameras that were improved, as far as the photos support them, into the frame that was given."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from blender_nep.cameras.alignment import angle, moved, similarity
from blender_nep.cameras.held_camera import Spread, held, off
from blender_nep.cameras.photo_folder import Photo
from blender_nep.cameras.structure_from_motion import Group, PlacedPhoto
from blender_nep.capture.cameras.camera import Camera
from blender_nep.errors import CaptureError
from blender_nep.messages import Message

_FEW_POINTS = 30
"""A photo with fewer scene points keeps the camera that was given."""
_GAIN = 0.1
"""The features must agree better by this share. A smaller gain is that of more free numbers."""
_FAR = 0.1
"""A camera that was turned by more radians, or moved by more of its distance, was given wrongly. Hardly any feature of its
photo agreed before, so the gain does not show that."""
_MEDIAN_2D, _MEDIAN_3D = 1.177, 1.538
"""Median length of a vector of two or three normal numbers, in standard deviations"""
_OUTLIER, _CLOSE = 3.0, 0.01
"""A camera that moved by more than so many times the median, and by more than `_CLOSE`, does not count for the frame."""


@dataclass(frozen=True)
class ImprovedCameras:
    """Cameras of all photos of a capture, in its own frame."""

    placed: list[PlacedPhoto]
    given: list[PlacedPhoto]
    """The same photos with their given cameras"""
    error_before: float
    """Median distance [pixels] between features and their scene points, with the given cameras"""
    error: float
    """The same with the improved cameras"""
    kept: list[str]
    """Names of the photos whose given cameras were kept, because these photos show too few scene points"""
    turned: float
    """Median angle [degrees] by which cameras were turned"""
    shifted: float
    """Median distance by which cameras were moved, as a part of their distance from the object"""
    largest: float
    """The largest of all turns [radians] and of all such distances"""

    @property
    def worthwhile(self) -> bool:
        """Whether the improved cameras explain the features clearly better, or some cameras were given wrongly."""
        return self.error < (1 - _GAIN) * self.error_before or self.largest > _FAR

    @property
    def chosen(self) -> list[PlacedPhoto]:
        """The improved cameras if they are worthwhile, else the given ones."""
        return self.placed if self.worthwhile else self.given

    def messages(self) -> tuple[list[Message], list[Message]]:
        """(what was found, warnings) in words."""
        warnings = [Message("cameras.kept", {"count": len(self.kept), "names": self.kept})] if self.kept else []
        if not self.worthwhile:
            return [Message("cameras.good_as_given", {"error": self.error_before})], warnings
        values = {
            "before": self.error_before,
            "after": self.error,
            "degrees": self.turned,
            "percent": 100 * self.shifted,
        }
        return [Message("cameras.improved", values)], warnings


def take_over(photos: Sequence[Photo], cameras: Sequence[Camera], group: Group, center: np.ndarray) -> ImprovedCameras:
    """The improved cameras of the photos, in the frame of the given `cameras`; center [3] is the object's in that frame.

    Raises CaptureError where too few photos show scene points.
    """
    given = {photo.path: camera for photo, camera in zip(photos, cameras, strict=True)}
    supported = [found for found in group.placed if found.points >= _FEW_POINTS]
    if len(supported) < max(3, len(photos) // 2) or group.error_before is None:
        raise CaptureError(
            f"only {len(supported)} of {len(photos)} photos share points that fit the given cameras",
            "These cannot be improved. The photos show too little, or the cameras are wrong (mirrored, or in another "
            "order). Find them anew, without --improve.",
            "capture.cameras_not_improved",
            placed=len(supported),
        )
    before = [given[found.photo.path] for found in supported]
    placed = _held(supported, before, center)
    changes = [_change(a, b.camera, center) for a, b in zip(before, placed, strict=True)]
    improved = {found.photo.path: found for found in placed}
    as_given = [PlacedPhoto(photo, given[photo.path], 0, 0.0) for photo in photos]
    kept = [photo for photo in photos if photo.path not in improved]
    return ImprovedCameras(
        [improved.get(found.photo.path, found) for found in as_given],
        as_given,
        group.error_before,
        float(np.median([found.error for found in placed])),
        [photo.path.name for photo in kept],
        float(np.median([turned for turned, _ in changes])),
        float(np.median([shifted for _, shifted in changes])),
        max(_size(change) for change in changes),
    )


def _held(found: Sequence[PlacedPhoto], given: Sequence[Camera], center: np.ndarray) -> list[PlacedPhoto]:
    """The found cameras in the frame of the given ones, each held near its given camera, unless that was given wrongly."""
    carry = _frame([one.camera for one in found], given, center)
    found = [one.moved(*carry) for one in found]
    turned, shifted = np.median([_change(a, b.camera, center) for a, b in zip(given, found, strict=True)], axis=0)
    error, placed = float(np.median([one.error for one in found])) / _MEDIAN_2D, []
    for one, before in zip(found, given, strict=True):
        away = float(np.linalg.norm(before.position - center))
        spread = Spread(float(np.radians(turned)) / _MEDIAN_3D, float(shifted) * away / _MEDIAN_3D, error)
        wrong = _size(_change(before, one.camera, center)) > _FAR
        best = one.camera if wrong else held(before, one.camera, one.seen, spread)
        placed.append(replace(one, camera=best, error=float(np.median(np.linalg.norm(off(best, one.seen), axis=1)))))
    return placed


def _frame(found: Sequence[Camera], given: Sequence[Camera], center: np.ndarray) -> tuple[np.ndarray, float, np.ndarray]:
    """As `similarity`, but cameras that were given wrongly do not count: they would turn and move all others."""
    count = range(len(found))
    carry = similarity(found, given)
    for _ in range(3):
        sizes = [_size(_change(given[i], moved(found[i], *carry), center)) for i in count]
        limit = max(_CLOSE, _OUTLIER * float(np.median(sizes)))
        good = [i for i in count if sizes[i] <= limit]
        carry = similarity([found[i] for i in good], [given[i] for i in good])
    return carry


def _change(given: Camera, improved: Camera, center: np.ndarray) -> tuple[float, float]:
    """(turn [degrees], distance as a part of the distance from `center`) between a given camera and the improved one."""
    away = np.linalg.norm(improved.position - given.position) / np.linalg.norm(given.position - center)
    return angle(given.camera_to_world[:3, :3].T @ improved.camera_to_world[:3, :3]), float(away)


def _size(change: tuple[float, float]) -> float:
    return max(float(np.radians(change[0])), change[1])
