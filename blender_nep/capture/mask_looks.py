"""What masks look like, each side of them: white and black.

The object lies where the cameras look. It seldom fills the borders of most photos. And its silhouettes agree: a body that
all of them show stands there. Each side of the masks is asked whether it can be such an object.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import ndimage

from blender_nep.capture.bounds import carve, hull_of_masks, sphere_from_masks
from blender_nep.capture.cameras.camera import Camera
from blender_nep.capture.photos.mask_files import MaskMeaning, MaskReading
from blender_nep.messages import Message

_GRID = 32
"""Points along each side of the cube where the space that silhouettes leave is measured"""
_WHITE_EVERYWHERE = 0.999
LEAST_OBJECT = 0.005
"""A smaller part of the photo is a blemish and no object."""
BORDER = 0.8
"""If white covers so much of the photos' borders, white is not the object."""
_FILL = 0.6
"""If the silhouettes leave so much of the space around the object, they show no object."""
_FILL_INSIDE = 0.85
"""... and this much where white does not cover most of the border: a large object may fill a photo."""
_MOSTLY_USABLE = 0.95
"""Black that covers less than the rest of a photo is left out, even where a body might explain it."""
_RECTANGLE = 0.97
"""White that covers so much of the rectangle around it is the inside of a frame."""
_LARGEST = 1.8
"""A body with a larger sphere, in radii of the sphere where the object is looked for, is no object."""
_LOOKED_AT = 0.8
"""If so much is white where the cameras look, black is not the object, or it has a hole there."""
_EXPLAINED = 0.6
"""So much of the silhouettes must lie in the sphere around the body that they agree on."""
_LEAST_MASKS = 6
"""Fewer silhouettes hardly contradict each other."""
_PATCH = 0.05
"""Half the side of the patch where the cameras look, as a part of the photo's shorter side"""


@dataclass(frozen=True)
class Judgment:
    """How masks are to be read, and why."""

    reading: MaskReading
    messages: list[Message]


def border_share(masks: Sequence[np.ndarray]) -> float:
    """The part of a photo's border that is white, 0..1 (median). masks: [h, w] bool each."""
    return float(np.median([np.concatenate([m[0], m[-1], m[:, 0], m[:, -1]]).mean() for m in masks]))


def place_looked_at(camera: Camera, center: np.ndarray) -> tuple[float, float] | None:
    """Where the photo shows `center` [3], as parts of its height and width; None where it does not."""
    x, y, depth = (float(value[0]) for value in camera.project(center[None]))
    if depth > 0 and 0 <= x < camera.width and 0 <= y < camera.height:
        return y / camera.height, x / camera.width
    return None


def patch_at(mask: np.ndarray, at: tuple[float, float]) -> np.ndarray:
    """The pixels around the place `at`, given as parts of height and width."""
    height, width = mask.shape
    row, column, half = int(at[0] * height), int(at[1] * width), max(1, round(_PATCH * min(height, width)))
    return mask[max(0, row - half) : row + half + 1, max(0, column - half) : column + half + 1]


class Sides:
    """The white and the black side of masks, each of which may be the object."""

    def __init__(self, cameras: Sequence[Camera], masks: Sequence[np.ndarray], center: np.ndarray, radius: float) -> None:
        """masks: [h, w] bool each, white. center [3], radius: of the sphere where the object is looked for."""
        self.cameras, self.white, self.center, self.radius = list(cameras), list(masks), center, radius

    @cached_property
    def black(self) -> list[np.ndarray]:
        """[h, w] bool of each mask"""
        return [~mask for mask in self.white]

    @cached_property
    def share(self) -> float:
        """The part of a photo that is white, 0..1 (median)."""
        return float(np.median([mask.mean() for mask in self.white]))

    @cached_property
    def mean_share(self) -> float:
        """The part of all photos that is white, 0..1."""
        return float(np.mean([mask.mean() for mask in self.white]))

    @cached_property
    def border(self) -> float:
        """The part of a photo's border that is white, 0..1 (median)."""
        return border_share(self.white)

    @cached_property
    def looked_at(self) -> float:
        """How much is white where the cameras look, 0..1 (median); 0.5 if no photo shows that place."""
        found = []
        for camera, mask in zip(self.cameras, self.white, strict=True):
            at = place_looked_at(camera, self.center)
            if at is not None:
                found.append(float(patch_at(mask, at).mean()))
        return float(np.median(found)) if found else 0.5

    @cached_property
    def alike(self) -> bool:
        """All masks are the same picture, and it is neither all white nor all black."""
        first = self.white[0]
        same = all(mask.shape == first.shape and (mask == first).all() for mask in self.white)
        return bool(len(self.white) > 1 and same and first.any() and not first.all())

    @cached_property
    def touches(self) -> bool:
        """White reaches opposite borders of the first mask."""
        first = self.white[0]
        return bool((first[0].any() and first[-1].any()) or (first[:, 0].any() and first[:, -1].any()))

    @cached_property
    def is_framed(self) -> bool:
        """White is a rectangle in most photos."""
        rows, columns = ([mask.any(axis).sum() for mask in self.white] for axis in (1, 0))
        parts = [m.sum() / max(1, r * c) for m, r, c in zip(self.white, rows, columns, strict=True)]
        return float(np.median(parts)) >= _RECTANGLE

    @cached_property
    def black_agrees(self) -> bool:
        """Black may be a body: most photos show it, and there is a place that is black in all of them."""
        shown = np.mean([mask.any() for mask in self.black])
        scaled = [mask.astype(np.float32) for mask in self.black]
        return bool(shown >= 0.5) and sphere_from_masks(self.cameras, scaled, self.center, self.radius) is not None

    def fill(self, masks: list[np.ndarray]) -> float:
        """The part of the space around the object that silhouettes leave, 0..1."""
        axis = np.linspace(-1.5, 1.5, _GRID) * self.radius
        points = self.center + np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3)
        framed, kept = carve(self.cameras, masks, points)
        return float(kept.sum() / max(1, framed.sum()))

    def covered(self, masks: list[np.ndarray]) -> float | None:
        """The part of a silhouette that the body explains on which all silhouettes agree, 0..1 (median).

        Right silhouettes have 0.98 and more, those of other photos 0.2 to 0.85. None: there are too few.
        """
        if sum(mask.any() for mask in masks) < _LEAST_MASKS:
            return None
        scaled = [mask.astype(np.float32) for mask in masks]
        hull = hull_of_masks(self.cameras, scaled, self.center, self.radius)
        if hull is None:
            return 0.0
        points, voxel = hull
        parts = []
        for camera, mask in zip(self.cameras, masks, strict=True):
            height, width = mask.shape
            x, y, depth = camera.project(points)
            with np.errstate(invalid="ignore"):
                row, column = np.floor(y * height / camera.height), np.floor(x * width / camera.width)
            ok = (depth > 0) & (row >= 0) & (row < height) & (column >= 0) & (column < width)
            if mask.any() and ok.any():
                body = np.zeros_like(mask)
                body[row[ok].astype(int), column[ok].astype(int)] = True
                pixels = voxel.max() * camera.fl_x * width / camera.width / float(np.median(depth[ok]))
                body = ndimage.binary_dilation(body, iterations=max(1, min(width, math.ceil(pixels))))
                parts.append(float((mask & body).sum() / mask.sum()))
        return float(np.median(parts)) if parts else None

    def is_body(self, masks: list[np.ndarray]) -> bool:
        """Whether the silhouettes agree on a body around the place where the cameras look, and show little beside it."""
        scaled = [mask.astype(np.float32) for mask in masks]
        sphere = sphere_from_masks(self.cameras, scaled, self.center, self.radius)
        if sphere is None or sphere[1] > _LARGEST * self.radius or self.fill(masks) > _FILL:
            return False
        if np.linalg.norm(sphere[0] - self.center) > 1.5 * sphere[1]:
            return False
        explained = []
        for camera, mask in zip(self.cameras, masks, strict=True):
            if mask.any():
                rows, columns = np.nonzero(mask)
                x, y = (columns + 0.5) * camera.width / mask.shape[1], (rows + 0.5) * camera.height / mask.shape[0]
                to_center = sphere[0] - camera.position
                along = camera.directions(x, y) @ to_center
                beside = np.sqrt(np.maximum((to_center**2).sum() - along**2, 0))
                explained.append(float(((along > 0) & (beside < sphere[1])).mean()))
        return bool(explained) and float(np.median(explained)) >= _EXPLAINED


def judge(sides: Sides, one_file: bool) -> Judgment:
    """What masks mean by what they look like. one_file: all photos have the same file."""
    if one_file:
        return _usable(sides, Message("capture.masks_one_for_all"))
    if min(mask.mean() for mask in sides.white) >= _WHITE_EVERYWHERE:
        return Judgment(MaskReading(MaskMeaning.NOTHING), [Message("capture.masks_white")])
    if sides.alike:
        return _judge_alike(sides)
    if sides.border < 0.5:
        # black is a frame around the photo, or silhouettes leave everything; an object that fills the photo leaves less
        if sides.share >= 0.5 and (sides.is_framed or sides.fill(sides.white) >= _FILL_INSIDE):
            return _usable(sides)
        # the object's own silhouettes show it where the cameras look, if it has no hole there
        if sides.looked_at < 0.3 and sides.is_body(sides.black) and not sides.is_body(sides.white):
            return judged_inverted()
        return Judgment(MaskReading(), [])
    if _is_inverted(sides):
        return judged_inverted() if sides.looked_at <= _LOOKED_AT else _doubtful(sides)
    if sides.share >= 0.5 and (sides.border >= BORDER or sides.fill(sides.white) >= _FILL or not sides.is_body(sides.white)):
        if sides.mean_share < _MOSTLY_USABLE and sides.black_agrees:  # it may be the object all the same
            return _doubtful(sides)
        return _usable(sides)
    return _unclear(sides)


def _is_inverted(sides: Sides) -> bool:
    """Whether black may be the object. An object that fills the photos has no silhouettes, but black where cameras look."""
    if 1 - sides.share < LEAST_OBJECT:
        return False
    fills = sides.looked_at <= 0.2 and sides.fill(sides.black) >= 0.1
    return fills or sides.is_body(sides.black)


def _judge_alike(sides: Sides) -> Judgment:
    """Masks that are all the same picture: of a ball in the middle, or of a rig that every photo shows at the same place."""
    alike = Message("capture.masks_alike")
    if sides.share <= 0.5 and sides.border < 0.5 and not sides.touches:
        return Judgment(MaskReading(), [] if _is_disc(sides.white[0]) else [alike])
    if sides.border >= BORDER and sides.looked_at < 0.5 and 1 - sides.share >= 0.05 and _is_inverted(sides):
        return Judgment(MaskReading(MaskMeaning.BACKGROUND), [*judged_inverted().messages, alike])
    return _usable(sides)


def _is_disc(mask: np.ndarray) -> bool:
    """Whether white is about as round as a ball in the middle of a photo, which looks alike from everywhere."""
    height, width = mask.any(1).sum(), mask.any(0).sum()
    return bool(abs(height - width) <= 0.15 * width and abs(mask.sum() / (height * width) - np.pi / 4) < 0.1)


def judged_inverted() -> Judgment:
    return Judgment(MaskReading(MaskMeaning.BACKGROUND), [Message("capture.masks_background")])


def _usable(sides: Sides, why: Message | None = None) -> Judgment:
    """White is what may be used. Masks that would leave out most of the photos are passed over."""
    percent = 100 * (1 - sides.mean_share)
    said = [why] if why else []
    if sides.share < 0.5:
        return Judgment(MaskReading(MaskMeaning.NOTHING), [*said, Message("capture.masks_not_used", {"percent": percent})])
    return Judgment(MaskReading(MaskMeaning.USABLE), [*said, Message("capture.masks_usable", {"percent": percent})])


def _unclear(sides: Sides) -> Judgment:
    """Nothing says that white is not the object. So it is believed."""
    return Judgment(MaskReading(), [Message("capture.masks_unclear", {"percent": 100 * sides.share})])


def _doubtful(sides: Sides) -> Judgment:
    """White cannot be the object, and black may be it. So black must not be left out, and it is not believed either."""
    return Judgment(MaskReading(MaskMeaning.NOTHING), [Message("capture.masks_doubtful", {"percent": 100 * sides.share})])
