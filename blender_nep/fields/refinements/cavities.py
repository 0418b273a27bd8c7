"""Opens cavities that the visual hull cannot show, such as the inside of a pot.

No ray through the opening of a pot meets the background. So the hull closes the opening by a lid, and the color heads paint
the inside onto the lid. But the photos disagree on the colors of a lid that is not there. They agree on those of the inside.

So the parts of the surface on which the photos disagree are tried as lids. The hypothesis is that the object behind the lid
is a vessel: a wall of one thickness, and nothing within. It is kept if the photos agree on its inside, and much better than
the same photos do on the lid. They do not agree on what is behind a mirror.

A bracelet and a lampshade have two openings, and light comes through. So the side that faces away from the lid is tried as a
second lid. Such a tube is kept if F_e explains what is seen through it much better than the lid does. Patches around the lid
are opened, too, as long as the photos are explained better without them.

The wall need not be exactly right, because learning goes on afterwards.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import torch
from scipy import ndimage
from torch import Tensor

from blender_nep.capture.rays.pixel_rays import PixelRays
from blender_nep.evidence.agreement import median_of_photos, views_that_show
from blender_nep.evidence.lids import LEAST_VIEWS, Background, Lid, ShownSurface
from blender_nep.evidence.sdf_grid import SdfGrid, distances_to
from blender_nep.evidence.small_photos import SmallPhotos
from blender_nep.fields.refinements.refinement import Change
from blender_nep.fields.stage import StageOne
from blender_nep.geometry.ray_tracing import RayTracer
from blender_nep.messages import Message, Part
from blender_nep.profiling import profiled

WALLS = (0.04, 0.08, 0.16)
"""Thicknesses of the wall that are tried first, in object radii."""
FINER, THINNEST = (0.75, 1.25), 0.02
"""Then, the best thickness is changed by these factors as long as that helps, down to THINNEST."""
LEAST_GAIN = 0.7
"""The photos must differ from the colors of the inside by less than this share of what they differ from the lid's."""
MOST_DIFFERENCE = 0.1
"""And by less than this (tone-mapped)."""
LEAST_KNOWN, LEAST_MOVED = 0.3, 0.25
"""Share of the pixels behind the lid whose color is known, and share of the lid's pixels that see what is behind it."""
LEAST_THROUGH, MOST_BEHIND = 0.05, 0.5
"""A tube counts if at least this share of the lid's pixels see through it, and if what is behind the object explains these
pixels with less than this share of the lid's difference. It is 0.3 to 0.5 on a gold cape, and at least 0.88 on solid
objects."""
MOST_OF_TUBE = 0.85
"""The error of a tube must be below this share of the lid's. It is 0.55 to 0.8 on a gold cape."""
PATCH = 0.12
"""The patches by which the lid of a tube grows are wider by this than two walls, in object radii. Smaller ones open nothing,
because a wall has its thickness towards all that is still closed."""
AROUND = 0.05
"""A patch is tried if it is so near to the lid, in object radii."""
MOST_OF_PATCH = 0.9
"""A patch belongs to the lid if the error of its pixels is below this share without it. It is 0.54 to 0.93 for parts of
the lid of a gold cape, and at least 1.3 for the gold."""
PIXELS_OF_PATCH, LEAST_OF_PATCH = 600, 50
"""Largest and smallest number of pixels by which a patch is judged"""


class CavityOpening:
    """Opens the cavities of an object whose outside is known. Takes 1 to 4 CPU seconds, and more if it finds a tube."""

    name = Part.CAVITIES

    def __init__(self, at: float) -> None:
        self.at = (at,)

    def skipped(self, stage: StageOne) -> Message | None:
        # Photos of a turntable disagree on every surface, because its light differs from photo to photo.
        return None if stage.rays.turntable is None else Message("reason.turntable")

    @torch.no_grad()
    def apply(self, stage: StageOne) -> Change:
        sdf = stage.object_field.sdf_in_cells()
        found = find_cavities(stage.rays, sdf, stage.renderer.background if stage.rays.background else None)
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
def find_cavities(rays: PixelRays, sdf: np.ndarray, background: Background | None) -> Cavities:
    """The cavities of an object with the SDF [n, n, n].

    The SDF belongs to the centers of n^3 cells of [-1, 1]^3, in radii of the object's sphere. Tubes need the background.
    """
    opened, surface = sdf, ShownSurface.of(SmallPhotos(rays), sdf, background)
    if surface is None:
        return Cavities(np.zeros_like(sdf), 0)
    lids = surface.lids()
    for lid in lids:
        found = _form_behind(lid, surface, opened)
        if found is not None:
            opened = np.maximum(opened, found.inside)
            if found.through:  # through an open tube, pixels of other parts see what is behind it, too
                break
    return Cavities(opened - sdf, len(lids))


def _form_behind(lid: Lid, surface: ShownSurface, sdf: np.ndarray) -> _Form | None:
    """The best vessel or tube behind the lid. None if there is none."""
    forms = [_best_form(lid, surface, sdf, through) for through in (False, True)]
    return min((form for form in forms if form is not None), key=lambda form: form.error, default=None)


class _Form(NamedTuple):
    """A vessel or a tube that the photos accept."""

    error: float
    """That of its `_Trial`"""
    inside: np.ndarray
    """[n, n, n] how far the cells are inside; -inf outside. With what lies above the lid, because the lid would stay as a
    thin sheet else"""
    through: bool
    """Whether it is a tube"""


def _best_form(lid: Lid, surface: ShownSurface, sdf: np.ndarray, through: bool) -> _Form | None:
    """The vessel behind the lid, or the tube (`through`), whose wall has the best thickness. None if the photos deny it."""
    grid, photos = SdfGrid(sdf), surface.photos
    open_to, cells = lid.above | lid.beyond if through else lid.above, lid.cells
    depth = _depth(grid, open_to)
    trials: dict[float, _Trial] = {}

    def error(wall: float) -> float:
        if wall not in trials:
            trials[wall] = _trial(lid, photos, np.maximum(sdf, depth - wall), through)
        return trials[wall].error

    if through and math.isinf(error(WALLS[0])):  # most objects are no tubes, so one trial must do
        return None
    wall = min(WALLS, key=error)
    of_lid = float(lid.difference.mean())
    if error(wall) >= of_lid:
        return None
    while error(better := min((max(wall * factor, THINNEST) for factor in FINER), key=error)) < error(wall):
        wall = better
    if not trials[wall].agrees or (through and error(wall) > MOST_OF_TUBE * of_lid):
        return None
    if through:
        open_to, cells = _grown(lid, surface, sdf, open_to, wall)
        depth = _depth(grid, open_to)
    labels, _ = ndimage.label(depth > wall)
    inside = np.isin(labels, np.unique(labels[cells & (labels > 0)]))
    smooth = np.where(inside, ndimage.gaussian_filter(depth, 1.0) - wall, -np.inf)
    return _Form(error(wall), smooth.astype(np.float32), through)


def _depth(grid: SdfGrid, open_to: np.ndarray) -> np.ndarray:
    """How deep the cells [n, n, n] lie below the surface, without its parts towards the cells open_to [n, n, n] bool."""
    depth, box = np.full(grid.values.shape, -0.5 * grid.cell), _bounding_box(grid.solid)
    depth[box] = distances_to(~(grid.solid | open_to)[box], grid.cell)
    return depth


def _grown(
    lid: Lid, surface: ShownSurface, sdf: np.ndarray, open_to: np.ndarray, wall: float
) -> tuple[np.ndarray, np.ndarray]:
    """What a tube is open to, and the cells of its lid, with the patches around it that are better explained without them.

    The photos happen to agree on some parts of a lid that face another way than the rest.
    """
    grid, cells, mask = SdfGrid(sdf), lid.cells, surface.surface.mask
    patch_of = surface.patches(PATCH + 2 * wall)
    is_open = (open_to | cells)[mask]
    left = [k for k in np.unique(patch_of) if is_open[patch_of == k].mean() <= 0.5]
    grew = True
    while grew:
        grew = False
        around = ndimage.binary_dilation(cells, iterations=round(AROUND / grid.cell))[mask]
        for k in [k for k in left if around[patch_of == k].any()]:
            patch = surface.cells(patch_of == k)
            own = surface.lid(patch, surface.volume_of(patch), np.zeros_like(patch), PIXELS_OF_PATCH)
            without = np.maximum(sdf, _depth(grid, open_to | own.above) - wall)
            shape = SdfGrid(without).traced_mesh()
            if shape is None or len(own.distance) < LEAST_OF_PATCH:
                continue
            seen = _sight(own, surface.photos, shape, grid.cell)
            opens = float((seen.clear | seen.moved).float().mean()) >= LEAST_MOVED
            if opens and seen.left(own, True).mean() < MOST_OF_PATCH * own.difference.mean():
                open_to, cells, grew = open_to | own.above, cells | patch, True
                left.remove(k)
    return open_to, cells


def _bounding_box(cells: np.ndarray, margin: int = 4) -> tuple[slice, ...]:
    """The block of a grid that holds the cells [n, n, n] bool, and `margin` cells around it."""
    return tuple(
        slice(max(0, part.start - margin), part.stop + margin) for part in ndimage.find_objects(cells.astype(np.uint8))[0]
    )


class _Sight(NamedTuple):
    """What the k pixels of a lid see behind it."""

    clear: Tensor
    """[k] bool: those that see through the object"""
    moved: Tensor
    """[k] bool: those that see another part of it, m pixels"""
    known: Tensor
    """[m] bool: those of them on whose colors some photos can agree"""
    before: Tensor
    """[m] how much they differ from the lid"""
    after: Tensor
    """[m] how much they differ from what they see, compared in the same photos"""

    def left(self, lid: Lid, through: bool) -> Tensor:
        """How much the pixels [k] differ from what they see. Without `through`, nothing is known of the clear ones."""
        left = lid.difference.clone()
        if through:
            left[self.clear] = lid.behind[self.clear]
        left[self.moved.nonzero().squeeze(1)[self.known]] = self.after[self.known]
        return left


def _sight(lid: Lid, photos: SmallPhotos, shape: RayTracer, cell: float) -> _Sight:
    distance, face, _ = shape.intersect(lid.origins.numpy(), lid.directions.numpy())
    distance = torch.from_numpy(distance)
    moved = distance.isfinite() & (distance > lid.distance + 1.5 * cell)
    points = (lid.origins + distance[:, None] * lid.directions)[moved]
    normals = torch.from_numpy(shape.face_normals[face[moved.numpy()]])
    normals = normals * -torch.sign((normals * lid.directions[moved]).sum(-1, keepdim=True))
    inside, outside = photos.surface_colors(points, normals, shape, inexact=cell), lid.shown[:, moved]
    both = torch.isfinite(inside + outside)  # Few photos show the inside. Fewer photos agree better on any colors.
    inside, outside = (torch.where(both, colors, torch.nan) for colors in (inside, outside))
    known = views_that_show(inside) >= LEAST_VIEWS
    before, after = ((lid.colors[moved] - median_of_photos(colors)).abs().mean(-1) for colors in (outside, inside))
    return _Sight(distance.isinf(), moved, known, before, after)


class _Trial(NamedTuple):
    error: float
    """Mean difference of the lid's pixels from the colors of the vessel; infinity if hardly a pixel sees its inside"""
    agrees: bool
    """Whether the photos agree on the inside"""


def _trial(lid: Lid, photos: SmallPhotos, vessel: np.ndarray, through: bool = False) -> _Trial:
    """Try a vessel (SDF [n, n, n]) behind the lid. `through`: it is a tube, through which pixels see what is behind it."""
    nothing = _Trial(float("inf"), False)
    grid = SdfGrid(vessel)
    shape = grid.traced_mesh()
    if shape is None:
        return nothing
    seen = _sight(lid, photos, shape, grid.cell)
    if (seen.clear | seen.moved if through else seen.moved).float().mean() < LEAST_MOVED:
        return nothing
    error = float(seen.left(lid, through).mean())
    if through:
        lid_there, behind = (float(part[seen.clear].mean()) for part in (lid.difference, lid.behind))
        clear = float(seen.clear.float().mean()) >= LEAST_THROUGH and behind <= MOST_BEHIND * lid_there
        return _Trial(error, True) if clear else nothing
    before, after = (float(part[seen.known].mean()) for part in (seen.before, seen.after))
    agrees = after < min(LEAST_GAIN * before, MOST_DIFFERENCE)
    return _Trial(error, agrees and float(seen.known.float().mean()) >= LEAST_KNOWN)
