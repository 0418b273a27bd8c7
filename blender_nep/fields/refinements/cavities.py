"""Opens cavities that the visual hull cannot show, such as the inside of a pot.

No ray through the opening of a pot meets the background. So the hull closes the opening by a lid, and the color heads paint
the inside onto the lid. But the photos disagree on the colors of a lid that is not there. They agree on those of the inside.

So the parts of the surface on which the photos disagree are tried as lids. The hypothesis is that the object behind the lid
is a vessel: a wall of one thickness, and nothing within. It is kept if the photos agree on its inside, and much better than
the same photos do on the lid. They do not agree on what is behind a mirror.

The wall need not be exactly right, because learning goes on afterwards.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from scipy import ndimage
from torch import Tensor

from blender_nep.capture.rays.pixel_rays import PixelRays
from blender_nep.evidence.agreement import difference, median_of_photos, views_that_show
from blender_nep.evidence.sdf_grid import SdfGrid, distances_to
from blender_nep.evidence.small_photos import SmallPhotos
from blender_nep.fields.refinements.refinement import Change
from blender_nep.fields.stage import StageOne
from blender_nep.messages import Message, Part
from blender_nep.profiling import profiled

DISAGREE = 1.6
"""A part of the surface may be a lid if the photos differ there by so many times the median of the whole surface."""
LEAST_LID, MOST_LIDS = 0.03, 6
"""Smallest area of a lid in squared object radii (a disc of 0.1 radii), and largest number of lids that are tried."""
FACING_ONE_WAY = 0.55
"""A part of a surface faces along an axis if the cosine between its normal and the axis is at least this. It is less than
1 / sqrt(3), so that every normal faces along an axis."""
SAME = 0.8
"""A part of the surface that shares this much with a larger one is not tried again."""
CLOSE = 0.1
"""Gaps of a lid up to twice this width belong to it, in object radii: photos happen to agree in some places of a lid."""
WALLS = (0.04, 0.08, 0.16)
"""Thicknesses of the wall that are tried first, in object radii."""
FINER, THINNEST = (0.75, 1.25), 0.02
"""Then, the best thickness is changed by these factors as long as that helps, down to THINNEST."""
RIM = 0.9
"""Share of a lid's cells that lie below its rim, along its mean normal."""
LEAST_GAIN = 0.7
"""The photos must differ from the colors of the inside by less than this share of what they differ from the lid's."""
MOST_DIFFERENCE = 0.1
"""And by less than this (tone-mapped)."""
LEAST_KNOWN, LEAST_MOVED = 0.3, 0.25
"""Share of the pixels behind the lid whose color is known, and share of the lid's pixels that see what is behind it."""
LEAST_VIEWS = 4
"""A color of the surface is known if at least so many photos show it."""
_PIXELS = 2000
"""Largest number of a lid's pixels that are compared."""


class CavityOpening:
    """Opens the cavities of an object whose outside is known. Takes 0.5 to 3 CPU seconds."""

    name = Part.CAVITIES

    def __init__(self, at: float) -> None:
        self.at = (at,)

    def skipped(self, stage: StageOne) -> Message | None:
        # Photos of a turntable disagree on every surface, because its light differs from photo to photo.
        return None if stage.rays.turntable is None else Message("reason.turntable")

    @torch.no_grad()
    def apply(self, stage: StageOne) -> Change:
        sdf = stage.object_field.sdf_in_cells()
        found = find_cavities(stage.rays, sdf)
        if not found.difference.any():
            return Change(False, {"parts_tried": found.lids})
        stage.object_field.add(stage.on_device(found.difference))
        opened = ((sdf < 0) & (sdf + found.difference > 0)).sum() / (sdf < 0).sum()
        return Change(True, {"parts_tried": found.lids, "share": float(opened)})


class Cavities(NamedTuple):
    """The cavities of an object."""

    difference: np.ndarray
    """[n, n, n] what must be added to the SDF so that the cavities are open; 0 elsewhere"""
    lids: int
    """Number of the parts of the surface that were tried as lids"""


@profiled("cavities")
def find_cavities(rays: PixelRays, sdf: np.ndarray) -> Cavities:
    """The cavities of an object with the SDF [n, n, n].

    The SDF belongs to the centers of n^3 cells of [-1, 1]^3, in radii of the object's sphere.
    """
    photos, opened = SmallPhotos(rays), sdf
    lids = _lids(photos, sdf)
    for lid in lids:
        opened = np.maximum(opened, _inside_behind(lid, photos, opened))
    return Cavities(opened - sdf, len(lids))


@dataclass
class _Lid:
    """A part of the surface that may cover a cavity, and the pixels [k] that show it."""

    cells: np.ndarray
    """[n, n, n] bool: cells of the surface that belong to the lid"""
    above: np.ndarray
    """[n, n, n] bool: cells that lie above the lid, and not beside the object. A wall has no thickness towards them."""
    origins: Tensor
    """[k, 3] the cameras"""
    directions: Tensor
    """[k, 3] unit vectors"""
    distance: Tensor
    """[k] from the camera to the lid"""
    colors: Tensor
    """[k, 3] tone-mapped colors of the pixels"""
    shown: Tensor
    """[views, k, 3] tone-mapped colors of the lid's points in all photos; NaN where a photo does not show the point"""
    difference: Tensor
    """[k] how much the pixels differ from the color of the lid"""


def _lids(photos: SmallPhotos, sdf: np.ndarray) -> list[_Lid]:
    """The parts of the surface on whose colors the photos disagree, largest first."""
    grid = SdfGrid(sdf)
    shape = grid.traced_mesh()
    if shape is None:
        return []
    surface, cameras = grid.surface(), photos.cameras.cpu()
    points, normals = torch.from_numpy(surface.points), surface.normals
    colors = photos.surface_colors(points, torch.from_numpy(normals), shape, inexact=grid.cell)
    median, known = median_of_photos(colors), views_that_show(colors) >= LEAST_VIEWS
    differs = difference(colors, median)
    if not known.any():
        return []
    disagree = (known & (differs > DISAGREE * differs[known].median())).numpy()
    nearest = ndimage.distance_transform_edt(~surface.mask, return_distances=False, return_indices=True)
    lids = []
    for part in _parts(surface.place[disagree], normals[disagree], len(sdf)):
        cells = _without_holes(_closed(part, round(CLOSE / grid.cell)) & surface.mask, surface.mask)
        row = torch.from_numpy(np.flatnonzero(cells[surface.mask]))
        view, each = torch.isfinite(colors[:, row, 0]).nonzero().T
        chosen = torch.randperm(len(view), generator=torch.Generator().manual_seed(0))[:_PIXELS]
        view, each = view[chosen], row[each[chosen]]
        color, away = colors[view, each], points[each] - cameras[view]
        distance = away.norm(dim=-1)
        directions = away / distance[:, None]
        lids.append(
            _Lid(
                cells,
                cells[tuple(nearest)] | _above(cells, normals[row.numpy()]),
                cameras[view],
                directions,
                distance,
                color,
                colors[:, each],
                (color - median[each]).abs().mean(-1),
            )
        )
    return lids


def _parts(place: np.ndarray, normals: np.ndarray, n: int) -> list[np.ndarray]:
    """Connected parts [n, n, n] bool of the cells place [k, 3] that face one way, largest first, at most MOST_LIDS.

    An opening faces one way. So what photos disagree on beside the lid, such as gold leaf on the outside of a pot, is not
    joined to the lid. A part may be in two of the list, because the six ways overlap.
    """
    found = []
    for axis, sign in itertools.product(range(3), (1, -1)):
        cells = np.zeros((n, n, n), bool)
        cells[tuple(place[sign * normals[:, axis] > FACING_ONE_WAY].T)] = True
        labels, count = ndimage.label(ndimage.binary_dilation(cells))
        areas = np.bincount((labels * cells).ravel(), minlength=count + 1) * (2 / n) ** 2
        areas[0] = 0
        found += [(area, labels == label) for label, area in enumerate(areas) if area >= LEAST_LID]
    found.sort(key=lambda part: -part[0])
    parts: list[np.ndarray] = []
    for _, cells in found:
        if len(parts) < MOST_LIDS and not any((cells & part).sum() > SAME * cells.sum() for part in parts):
            parts.append(cells)
    return parts


def _closed(cells: np.ndarray, by: int) -> np.ndarray:
    """The cells [n, n, n] bool with their gaps up to 2 `by` cells wide, also at the border of the grid."""
    return ndimage.binary_closing(np.pad(cells, by), iterations=by)[(slice(by, -by),) * 3]


def _without_holes(cells: np.ndarray, surface: np.ndarray) -> np.ndarray:
    """A lid [n, n, n] and the parts of the surface [n, n, n] that it encloses, where the photos happen to agree."""
    rest, _ = ndimage.label(surface & ~cells, np.ones((3, 3, 3)))
    sizes = np.bincount(rest.ravel())
    sizes[0] = 0
    touched = np.unique(rest[ndimage.binary_dilation(cells)])
    holes = touched[(touched > 0) & (touched != sizes.argmax()) & (sizes[touched] < cells.sum())]
    return cells | np.isin(rest, holes)


def _above(cells: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """The cells [n, n, n] above the rim of a lid with cells [n, n, n] and normals [k, 3]: above its highest cells.

    The rim of a thick wall is no part of the lid, but what lies above it lies above the lid.
    """
    up, n = normals.mean(0), len(cells)
    axis = np.arange(n)
    height = up[0] * axis[:, None, None] + up[1] * axis[:, None] + up[2] * axis
    return height > np.quantile(height[cells], RIM)


def _inside_behind(lid: _Lid, photos: SmallPhotos, sdf: np.ndarray) -> np.ndarray:
    """How far the cells [n, n, n] are inside of the best vessel behind the lid; -inf if there is none.

    Positive inside. With what lies above the lid, because the lid would stay as a thin sheet else.
    """
    grid = SdfGrid(sdf)
    depth, box = np.full(sdf.shape, -0.5 * grid.cell), _bounding_box(grid.solid)
    depth[box] = distances_to(~(grid.solid | lid.above)[box], grid.cell)
    trials: dict[float, _Trial] = {}

    def error(wall: float) -> float:
        if wall not in trials:
            trials[wall] = _trial(lid, photos, np.maximum(sdf, depth - wall))
        return trials[wall].error

    nothing = np.full(sdf.shape, -np.inf, np.float32)
    wall = min(WALLS, key=error)
    if error(wall) >= float(lid.difference.mean()):
        return nothing
    while error(better := min((max(wall * factor, THINNEST) for factor in FINER), key=error)) < error(wall):
        wall = better
    if not trials[wall].agrees:
        return nothing
    labels, _ = ndimage.label(depth > wall)
    inside = np.isin(labels, np.unique(labels[lid.cells & (labels > 0)]))
    return np.where(inside, ndimage.gaussian_filter(depth, 1.0) - wall, -np.inf).astype(np.float32)


def _bounding_box(cells: np.ndarray, margin: int = 4) -> tuple[slice, ...]:
    """The block of a grid that holds the cells [n, n, n] bool, and `margin` cells around it."""
    return tuple(
        slice(max(0, part.start - margin), part.stop + margin) for part in ndimage.find_objects(cells.astype(np.uint8))[0]
    )


class _Trial(NamedTuple):
    error: float
    """Mean difference of the lid's pixels from the colors of the vessel; infinity if hardly a pixel sees its inside"""
    agrees: bool
    """Whether the photos agree on the inside"""


def _trial(lid: _Lid, photos: SmallPhotos, vessel: np.ndarray) -> _Trial:
    """Try a vessel (SDF [n, n, n]) behind the lid."""
    nothing = _Trial(float("inf"), False)
    grid = SdfGrid(vessel)
    shape = grid.traced_mesh()
    if shape is None:
        return nothing
    distance, face, _ = shape.intersect(lid.origins.numpy(), lid.directions.numpy())
    distance, cell = torch.from_numpy(distance), grid.cell
    moved = distance.isfinite() & (distance > lid.distance + 1.5 * cell)
    if moved.float().mean() < LEAST_MOVED:
        return nothing
    points = (lid.origins + distance[:, None] * lid.directions)[moved]
    normals = torch.from_numpy(shape.face_normals[face[moved.numpy()]])
    normals = normals * -torch.sign((normals * lid.directions[moved]).sum(-1, keepdim=True))
    inside, outside = photos.surface_colors(points, normals, shape, inexact=cell), lid.shown[:, moved]
    both = torch.isfinite(inside + outside)  # Few photos show the inside. Fewer photos agree better on any colors.
    inside, outside = (torch.where(both, colors, torch.nan) for colors in (inside, outside))
    known = views_that_show(inside) >= LEAST_VIEWS
    before, after = ((lid.colors[moved] - median_of_photos(colors)).abs().mean(-1)[known] for colors in (outside, inside))
    agrees = float(after.mean()) < min(LEAST_GAIN * float(before.mean()), MOST_DIFFERENCE)
    left = lid.difference.clone()
    left[moved.nonzero().squeeze(1)[known]] = after
    return _Trial(float(left.mean()), agrees and float(known.float().mean()) >= LEAST_KNOWN)
