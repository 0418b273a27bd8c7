"""Finds the object's sphere in a capture whose files do not name it, by a quick visual hull.

A sphere that is 1.3 times too large costs 13 % of the distance of the mesh, because the grid's cells are that much larger.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch

from blender_nep.capture.brightness import to_brightness
from blender_nep.capture.capture import Capture
from blender_nep.capture.exposure import find_exposures
from blender_nep.capture.pixel_rays import PixelRays
from blender_nep.fields.training import FieldsLearning
from blender_nep.presets import preset

_PIXELS, _STEPS = 10_000, 150
"""Pixels of each photo, and steps of F_e. They suffice for a hull with cells of 1/32 of the radius."""
_MARGIN = 1.08
"""The sphere is so much larger than the hull's, because thin parts may be missing in a quick hull."""
_BORDER, _MOST_AT_BORDER = 0.95, 0.005
"""The hull is cut off by the sphere if more than this share of it lies beyond 0.95 of the radius."""
_WORTHWHILE = 0.95
"""A sphere is replaced only by one that is smaller by this factor."""
_AGAIN, _ROUNDS = 0.6, 3
"""After a sphere became smaller by this factor, its hull was coarse, and is made again."""


@dataclass(frozen=True)
class ObjectSphere:
    """The object's sphere in the capture's frame and units."""

    center: np.ndarray
    """[3]"""
    radius: float
    sure: bool
    """False if no clear hull was found, or if the sphere from which the search began cuts it off"""


def find_object_sphere(
    capture: Capture, seed: int = 0, *, check: Callable[[int, int], None] = lambda done, all_of_them: None
) -> ObjectSphere:
    """Look for the object within the capture's present sphere, and shrink the sphere around it. Masks are not used.

    The photos are read once in each of at most three rounds; a round takes about 10 CPU seconds for 60 photos.
    check(done, all) is called after each photo and each step of a round, and may raise to end the search. Raises
    CaptureError and BoundsError as `PixelRays.from_capture` does.
    """
    center, radius, sure = capture.object_center, capture.object_radius, False
    for _ in range(_ROUNDS):
        found = _hull_sphere(replace(capture, object_center=center, object_radius=radius, warnings=[]), seed, check)
        if found is None:
            break
        sure = True
        away, size = found[0], _MARGIN * found[1]
        if size > _WORTHWHILE:
            break
        center, radius = center + radius * away, radius * size
        if size > _AGAIN:
            break
    return ObjectSphere(center, radius, sure)


def _hull_sphere(capture: Capture, seed: int, check: Callable[[int, int], None]) -> tuple[np.ndarray, float] | None:
    """Center [3] and radius of a sphere around the hull, in the unit frame. None without a clear hull inside the sphere."""
    quick = preset("preview")
    quick = replace(quick, fields=replace(quick.fields, background_steps=_STEPS))
    rays = PixelRays.from_capture(capture, _PIXELS, use_masks=False, progress=check)
    exposures = find_exposures(rays)
    rays = to_brightness(rays.with_gain(exposures.gain, exposures.vignetting), quick.brightness)
    learning = FieldsLearning(rays, quick, seed, torch.device("cpu"))
    while learning.schedule.learns_background:
        learning.learn_step()
        check(learning.schedule.step, learning.schedule.background_steps)
    hull = learning.hull_without_masks() if learning.schedule.background_steps else None
    if hull is None or hull.contrast < quick.fields.least_contrast:
        return None
    inside = np.argwhere(hull.sdf < 0) / (len(hull.sdf) - 1) * 2 - 1
    if not len(inside) or (np.linalg.norm(inside, axis=1) > _BORDER).mean() > _MOST_AT_BORDER:
        return None
    middle = (inside.min(0) + inside.max(0)) / 2
    return middle, float(np.linalg.norm(inside - middle, axis=1).max())
