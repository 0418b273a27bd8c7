"""Finds the object's sphere in a capture whose files do not name it, by a quick visual hull.

A sphere that is 1.3 times too large costs 13 % of the distance of the mesh, because the grid's cells are that much larger.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from trimesh.nsphere import minimum_nsphere

from blender_nep.cameras.seen_through import Sightlines, seen_through, without_free_space
from blender_nep.capture.brightness import to_brightness
from blender_nep.capture.capture import Capture
from blender_nep.capture.exposure.from_exif import exposures_of
from blender_nep.capture.exposure.surroundings import compare_exposures
from blender_nep.capture.rays.pixel_rays import PixelRays
from blender_nep.capture.turntable.motions import in_unit_frame, on_turntable
from blender_nep.errors import CaptureError
from blender_nep.evidence.observation import visible
from blender_nep.evidence.occluders import MeshOccluder
from blender_nep.evidence.sdf_grid import SdfGrid
from blender_nep.fields.refinements.hull import hull_without_masks
from blender_nep.fields.refinements.support import support_by_hull
from blender_nep.fields.training import FieldsLearning
from blender_nep.fields.visual_hull import LOWEST_SHARE
from blender_nep.presets import preset
from blender_nep.scene.scene import Scene

_PIXELS, _STEPS = 10_000, 150
"""Pixels of each photo, and steps of F_e. They suffice for a hull with cells of 1/32 of the radius."""
_MARGIN = 1.08
"""The sphere is so much larger than the hull's, because thin parts may be missing in a quick hull."""
_BORDER, _MOST_AT_BORDER = 0.95, 0.005
"""The sphere cuts the hull off if more than this share of its seen surface lies beyond 0.95 of the radius."""
_FACING = 0.05
"""A photo shows a place of the hull if the cosine of the viewing angle is above this. A hull's faces are only roughly
right, so nearly all angles count."""
_LEAST_SEEN = 100
"""Faces of the hull that photos must show. With fewer, there may be no sphere around them."""
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
    capture: Capture,
    lines: Sightlines = (),
    *,
    seed: int = 0,
    check: Callable[[int, int], None] = lambda done, all_of_them: None,
) -> ObjectSphere:
    """Look for the object within the capture's present sphere, and shrink the sphere around it. Masks are not used.

    `lines`, in the capture's frame, tell where space is free. If the sphere cuts the object off, and is large enough for it,
    it is moved first. The photos are read once in each of at most three rounds; a round takes about 10 CPU seconds for 60
    photos. check(done, all) is called after each photo and each step of a round, and may raise to end the search. Raises
    CaptureError and BoundsError as `PixelRays.from_capture` does.
    """
    center, radius, sure = capture.object_center, capture.object_radius, False
    moved = np.zeros(3)
    for _ in range(_ROUNDS):
        around = replace(capture, object_center=center + moved, object_radius=radius, warnings=[])
        found = _hull_sphere(around, lines, seed, check)
        if found is None:
            break
        size = _MARGIN * found.reach
        if found.cut and size > 1:  # the hull is larger than the sphere
            break
        if found.cut:
            moved = moved + radius * found.middle
            continue
        sure = True
        if size > _WORTHWHILE and not moved.any():
            break
        center, moved, radius = center + moved + radius * found.middle, np.zeros(3), radius * size
        if size > _AGAIN:
            break
    return ObjectSphere(center, radius, sure)


@dataclass(frozen=True)
class _HullSphere:
    """The smallest sphere around the seen surface of a hull, in the unit frame."""

    middle: np.ndarray
    """[3]"""
    reach: float
    """Its radius"""
    cut: bool
    """Whether the unit sphere cuts the hull off where photos see it"""


def _hull_sphere(capture: Capture, lines: Sightlines, seed: int, check: Callable[[int, int], None]) -> _HullSphere | None:
    """The sphere around the hull that the photos show in the capture's sphere. None without a clear hull."""
    quick = preset("preview")
    quick = replace(quick, fields=replace(quick.fields, background_steps=_STEPS))
    capture = _knowing_turns(capture)
    rays = PixelRays.from_capture(capture, _PIXELS, use_masks=False, progress=check)
    if capture.views[0].in_room is not None:
        rays = rays.with_turntable(in_unit_frame(capture, capture.views[0]))
    exposures = exposures_of(capture, compare_exposures(rays))
    rays = to_brightness(rays.with_gain(exposures.gain, exposures.vignetting), quick.brightness)
    learning = FieldsLearning(Scene.of(rays), quick, seed)
    while learning.schedule.learns_background:
        learning.learn_step()
        check(learning.schedule.step, learning.schedule.background_steps)
    hull = None
    if learning.schedule.background_steps:
        learning.stand_on(support_by_hull(learning))
        hull = hull_without_masks(learning)
    if hull is None or hull.contrast < quick.fields.least_contrast:
        return None
    free = seen_through(lines, capture.object_center, capture.object_radius)
    seen = _seen_surface(without_free_space(hull.sdf, free), rays)
    if len(seen) < _LEAST_SEEN:
        return None
    middle, reach = minimum_nsphere(seen)
    cut = (np.linalg.norm(seen, axis=1) > _BORDER).mean() > _MOST_AT_BORDER
    return _HullSphere(middle, float(reach), bool(cut))


def _knowing_turns(capture: Capture) -> Capture:
    """The capture with the motions of a turntable's object. Where the cameras do not fit a turntable, as it is."""
    if not capture.turntable:
        return capture
    try:
        return on_turntable(capture).capture
    except CaptureError:  # the job says so
        return capture


def _seen_surface(hull: np.ndarray, rays: PixelRays) -> np.ndarray:
    """Points [n, 3] of the surface of a hull, in the unit frame: those that more photos show than the carving forgives.

    hull: [n, n, n], negative inside.
    Under an object that few photos show from below, the hull may reach the end of the sphere. Photos show that part of its
    surface at a grazing angle only.
    """
    grid, device = SdfGrid(hull), rays.radiance.device
    shape = grid.traced_mesh()
    if shape is None:
        return np.zeros((0, 3))
    points = shape.vertices[shape.faces].mean(1)
    at, normals = torch.from_numpy(points).to(device), torch.from_numpy(shape.face_normals).to(device)
    occluder = MeshOccluder(shape, ahead=grid.cell)  # the hull is known to a cell
    photos = np.zeros(len(points), np.int64)
    for view in range(rays.views):
        seen = visible(rays, view, at, normals, occluder, least_cosine=_FACING, two_sided=True)
        photos[seen.index.cpu().numpy()] += 1
    return points[photos > 1 + LOWEST_SHARE * rays.views]
