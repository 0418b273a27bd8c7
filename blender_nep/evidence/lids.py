"""The surface of an object as the photos show it: parts that may be lids, and the pixels that show each part.

A lid is a part of the surface on whose colors the photos disagree, because it is not there: it closes the opening of a
cavity. What is behind it is seen through it.
"""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from scipy import ndimage
from scipy.cluster.vq import kmeans2
from torch import Tensor

from blender_nep.capture.rays.ray_bundle import RayBundle
from blender_nep.evidence.agreement import difference, median_of_photos, views_that_show
from blender_nep.evidence.sdf_grid import SdfGrid, SurfaceCells
from blender_nep.evidence.small_photos import SmallPhotos
from blender_nep.geometry.ray_tracing import RayTracer
from blender_nep.tone_mapping import tone_map

Background = Callable[[RayBundle], Tensor]
"""The radiance [n, 3] that rays [n] would have without the object"""
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
RIM = 0.9
"""Share of a lid's cells that lie below its rim, along its mean normal."""
_PIXELS = 2000
"""Largest number of a lid's pixels that are compared."""
_ROUNDS = 8
"""Iterations of the k-means that divides a surface into patches"""
LEAST_VIEWS = 4
"""A color of the surface is known if at least so many photos show it."""


@dataclass
class Lid:
    """A part of the surface that may cover a cavity, and the pixels [k] that show it."""

    cells: np.ndarray
    """[n, n, n] bool: cells of the surface that belong to the lid"""
    above: np.ndarray
    """[n, n, n] bool: cells that lie above the lid, and not beside the object. A wall has no thickness towards them."""
    beyond: np.ndarray
    """[n, n, n] bool: the same for the side of the object that faces away from the lid"""
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
    behind: Tensor
    """[k] how much the pixels differ from what is behind the object"""


class ShownSurface:
    """The surface of an object, and the colors that the photos show there."""

    @classmethod
    def of(cls, photos: SmallPhotos, sdf: np.ndarray, background: Background | None) -> ShownSurface | None:
        """sdf [n, n, n] belongs to the centers of n^3 cells of [-1, 1]^3. None: nothing is inside.

        Without a background, nothing explains what is seen through the object.
        """
        grid = SdfGrid(sdf)
        shape = grid.traced_mesh()
        return None if shape is None else cls(photos, grid, shape, background)

    def __init__(self, photos: SmallPhotos, grid: SdfGrid, shape: RayTracer, background: Background | None) -> None:
        """`shape` is the surface of the grid. `of` makes both."""
        self.photos, self.grid, self.background = photos, grid, background
        self.surface: SurfaceCells = self.grid.surface()
        self.points = torch.from_numpy(self.surface.points)
        normals = torch.from_numpy(self.surface.normals)
        self.colors = photos.surface_colors(self.points, normals, shape, inexact=self.grid.cell)
        """[views, k, 3]; NaN where a photo does not show the point"""
        self.median = median_of_photos(self.colors)
        """[k, 3]"""
        self.known = views_that_show(self.colors) >= LEAST_VIEWS
        """[k] bool"""
        self._cameras, self._half_angle = photos.cameras.cpu(), photos.half_angle.cpu()
        mask = ~self.surface.mask
        self._nearest = ndimage.distance_transform_edt(mask, return_distances=False, return_indices=True)

    def lids(self) -> list[Lid]:
        """The parts of the surface on whose colors the photos disagree, largest first."""
        differs = difference(self.colors, self.median)
        if not self.known.any():
            return []
        disagree = (self.known & (differs > DISAGREE * differs[self.known].median())).numpy()
        mask, normals = self.surface.mask, self.surface.normals
        found = []
        for part in _parts(self.surface.place[disagree], normals[disagree], len(mask)):
            cells = _without_holes(_closed(part, round(CLOSE / self.grid.cell)) & mask, mask)
            own = normals[cells[mask]]
            far = _far_side(self.surface, own.mean(0))
            beyond = self.volume_of(far) | _above(far, normals[far[mask]])
            found.append(self.lid(cells, self.volume_of(cells) | _above(cells, own), beyond))
        return found

    def volume_of(self, cells: np.ndarray) -> np.ndarray:
        """The cells [n, n, n] bool whose nearest cells of the surface are among `cells` [n, n, n] bool."""
        return cells[tuple(self._nearest)]

    def lid(self, cells: np.ndarray, above: np.ndarray, beyond: np.ndarray, pixels: int = _PIXELS) -> Lid:
        """The cells [n, n, n] bool of the surface as a lid, with at most so many of the pixels that show them."""
        cameras = self._cameras
        row = torch.from_numpy(np.flatnonzero(cells[self.surface.mask]))
        view, each = torch.isfinite(self.colors[:, row, 0]).nonzero().T
        chosen = torch.randperm(len(view), generator=torch.Generator().manual_seed(0))[:pixels]
        view, each = view[chosen], row[each[chosen]]
        color, away = self.colors[view, each], self.points[each] - cameras[view]
        distance = away.norm(dim=-1)
        directions = away / distance[:, None]
        rays = RayBundle(cameras[view], directions, self._half_angle[view])
        return Lid(
            cells=cells,
            above=above,
            beyond=beyond,
            origins=rays.origins,
            directions=directions,
            distance=distance,
            colors=color,
            shown=self.colors[:, each],
            difference=(color - self.median[each]).abs().mean(-1),
            behind=(color - self._behind(rays)).abs().mean(-1),
        )

    def patches(self, width: float) -> np.ndarray:
        """The surface in patches about as wide as `width`, in object radii: [k] int, the patch of each of its cells."""
        points = np.concatenate([self.surface.points / width, self.surface.normals], 1)
        count = max(1, round(len(points) * (self.grid.cell / width) ** 2))
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of empty patches, which are left out
            _, label = kmeans2(points, count, _ROUNDS, minit="points", seed=np.random.default_rng(0))
        return label

    def cells(self, chosen: np.ndarray) -> np.ndarray:
        """The `chosen` [k] bool of the surface's cells: [n, n, n] bool."""
        cells = np.zeros_like(self.surface.mask)
        cells[tuple(self.surface.place[chosen].T)] = True
        return cells

    def _behind(self, rays: RayBundle) -> Tensor:
        """Tone-mapped colors [k, 3] of what is behind the object, on the CPU."""
        if len(rays) == 0 or self.background is None:
            return torch.full((len(rays), 3), torch.inf)
        origins, directions, half_angle = (part.to(self.photos.photos.device) for part in rays)
        return tone_map(self.background(RayBundle(origins, directions, half_angle))).cpu()


def _far_side(surface: SurfaceCells, axis: np.ndarray) -> np.ndarray:
    """The largest connected part [n, n, n] bool of the surface that faces against the axis [3]."""
    cells = np.zeros_like(surface.mask)
    cells[tuple(surface.place[surface.normals @ axis < -FACING_ONE_WAY * np.linalg.norm(axis)].T)] = True
    labels, count = ndimage.label(ndimage.binary_dilation(cells))
    if count == 0:
        return cells
    return cells & (labels == 1 + np.bincount((labels * cells).ravel(), minlength=count + 1)[1:].argmax())


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
    if not cells.any():
        return cells
    up, n = normals.mean(0), len(cells)
    axis = np.arange(n)
    height = up[0] * axis[:, None, None] + up[1] * axis[:, None] + up[2] * axis
    return height > np.quantile(height[cells], RIM)
