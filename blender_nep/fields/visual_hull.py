"""Finds a visual hull of the object before the object field is learned.

F_e is learned first, alone, from the pixels whose rays miss the object's sphere. Its prediction for the other pixels is
right where they see through the sphere, and wrong where they see the object. So the residual is a soft silhouette. Space
carving (Kutulakos and Seitz 2000) with the silhouettes gives the object's visual hull. Nothing has to be segmented. With
masks, the masks are the silhouettes.

If the SDF starts near the truth, its surface can be sharp at once. A soft surface has time to explain highlights by dents,
and a small sphere does not reach thin parts before it is sharp.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from scipy import ndimage
from skimage.filters import threshold_otsu
from torch.nn import functional

from blender_nep.capture.rays.pixel_rays import PixelRays
from blender_nep.capture.rays.pixel_width import pixel_width
from blender_nep.capture.rays.ray_bundle import RayBundle
from blender_nep.evidence.sdf_grid import SdfGrid, cell_centers, distances_to
from blender_nep.tone_mapping import tone_map

LOWEST_SHARE = 0.05
"""The score of a point is this quantile of its silhouette values over the views. It is low, so that nearly all views must
agree."""
LEAST_COMPONENT = 0.02
"""Connected components smaller than this share of the largest one are dropped."""
ON_SUPPORT = 0.6
"""For an object on a support plane, the threshold of the scores is this share of Otsu's. A mirror there reflects the plane,
so some of its parts have low scores. Without a plane, the lower threshold would close the holes of mirrors."""
EXCESS_SHARE = 0.25
"""A cell of the object is free space if its score is below this share of the median score of the object's cells."""
LEAST_EXCESS = 27
"""Connected free cells in the object count only if there are at least this many."""
LEAST_VOLUME, MOST_VOLUME = 0.002, 0.7
"""Smallest and largest share of the sphere that the hull of an object may fill."""


@dataclass
class VisualHull:
    """A carved hull in the unit frame."""

    sdf: np.ndarray
    """[n, n, n] signed distances at the centers of n^3 cells of [-1, 1]^3, negative inside"""
    volume: float
    """Share of the sphere that the hull fills"""
    contrast: float
    """Mean score inside the hull divided by that outside; well above 1 if there is an object"""


def background_silhouettes(
    background: Callable[[RayBundle], torch.Tensor],
    rays: PixelRays,
    block: int = 4,
    wanted: Callable[[RayBundle], torch.Tensor] | None = None,
) -> list[torch.Tensor]:
    """For each view [H / block, W / block]: the absolute tone-mapped difference between the photo and the background.

    background(rays) gives the radiance [n, 3] without the object. It is asked only of the rays for which wanted(rays) [n] is
    true; the others get the value 0. Without `wanted`, these are the rays of `near_sphere`. The photo is averaged over each
    block; the background is rendered for one ray of it.
    """
    # All maps are made first. Made between the large arrays of the loop, they would keep the heap from reusing that memory.
    maps = [torch.empty(max(h // block, 1), max(w // block, 1), device=rays.radiance.device) for h, w in rays.size]
    for view, (height, width) in enumerate(rays.size):
        start, end = rays.offset[view], rays.offset[view + 1]
        rows, columns = maps[view].shape
        row = torch.arange(rows, device=rays.radiance.device) * height // rows + min(block // 2, height - 1)
        column = torch.arange(columns, device=rays.radiance.device) * width // columns + min(block // 2, width - 1)
        index = (start + row[:, None] * width + column).flatten()
        bundle = rays.rays(index)
        asked = near_sphere(bundle, block) if wanted is None else wanted(bundle)
        radiance = torch.zeros_like(bundle.directions)
        radiance[asked] = background(bundle[asked])
        photo = rays.photo(torch.arange(start, end, device=rays.radiance.device)).reshape(height, width, 3)
        photo = functional.adaptive_avg_pool2d(tone_map(photo).permute(2, 0, 1), (rows, columns)).permute(1, 2, 0)
        difference = (tone_map(radiance).reshape(rows, columns, 3) - photo).abs().mean(-1)
        maps[view].copy_(difference * asked.reshape(rows, columns))
    return maps


def near_sphere(rays: RayBundle, block: int) -> torch.Tensor:
    """Whether the values of rays [n] may count for points in the unit sphere: [n] bool.

    Each ray stands for a block of block^2 pixels. The value of a point is interpolated between the centers of the four
    nearest blocks, which lie less than two blocks away.
    """
    along = (rays.origins * rays.directions).sum(-1)
    closest = (rays.origins - along[:, None] * rays.directions).norm(dim=-1)
    return closest < 1 + 2 * block * pixel_width(rays.half_angle) * rays.origins.norm(dim=-1)


def mask_silhouettes(rays: PixelRays, block: int = 4, views: list[int] | None = None) -> list[torch.Tensor]:
    """For each of the views (None: all) [H / block, W / block]: the mean of the object mask, 0..1.

    NaN for a view that is left out as a whole, so that it does not vote. Raises ValueError for rays without masks.
    """
    if rays.mask is None:
        raise ValueError("silhouettes by masks need masks")
    maps = []
    for view in range(rays.views) if views is None else views:
        (height, width), pixels = rays.size[view], slice(rays.offset[view], rays.offset[view + 1])
        mask = rays.mask[pixels].float().reshape(1, height, width) / 255
        if not rays.valid[pixels].any():
            mask.fill_(torch.nan)
        maps.append(functional.adaptive_avg_pool2d(mask, (max(height // block, 1), max(width // block, 1)))[0])
    return maps


def score_cells(rays: PixelRays, silhouettes: list[torch.Tensor], cells: int, share: float = LOWEST_SHARE) -> np.ndarray:
    """Scores [cells, cells, cells] of the cells of [-1, 1]^3: how much nearly all views see an object there.

    share: the score is this quantile of the silhouettes' values over the views. NaN outside the unit sphere, and where no
    view sees the cell.
    """
    axis = cell_centers(cells)
    centers = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1)
    in_sphere = np.linalg.norm(centers, axis=-1) < 1
    points = torch.from_numpy(centers[in_sphere].astype(np.float32)).to(rays.radiance.device)
    score = np.full(in_sphere.shape, np.nan, np.float32)
    score[in_sphere] = _score(rays, silhouettes, points, share).cpu().numpy()
    return score


def carve(score: np.ndarray, on_support: bool = False) -> VisualHull | None:
    """The visual hull of cells with scores [n, n, n] (`score_cells`), or None if the scores show no object.

    on_support: whether the object stands on a support plane, which it may mirror.
    """
    known = np.isfinite(score)
    if not known.any() or np.ptp(score[known]) < 1e-6:
        return None
    solid = np.nan_to_num(score) > threshold_otsu(score[known]) * (ON_SUPPORT if on_support else 1)
    labels, count = ndimage.label(solid)
    if count == 0:
        return None
    size = np.bincount(labels.ravel())[1:]
    solid = np.isin(labels, 1 + np.flatnonzero(size >= LEAST_COMPONENT * size.max()))
    solid = ndimage.binary_fill_holes(solid)
    volume = solid.sum() / (np.pi / 6 * solid.size)
    if not LEAST_VOLUME <= volume <= MOST_VOLUME:
        return None
    above = known & solid
    contrast = float(score[above].mean() / max(score[known & ~above].mean(), 1e-6)) if above.any() else 0.0
    sdf = ndimage.gaussian_filter(SdfGrid.of_solid(solid).values, 1.0).astype(np.float32)
    return VisualHull(sdf, float(volume), contrast)


def excess(rays: PixelRays, silhouettes: list[torch.Tensor], sdf: np.ndarray) -> np.ndarray:
    """What must be added to an object's SDF [n, n, n] so that free space is not a part of the object; 0 elsewhere.

    sdf and the result belong to the centers of n^3 cells of [-1, 1]^3, in radii of the object's sphere. A cell of the object
    is free if nearly all views agree that the background alone explains the photos there.
    """
    grid = SdfGrid(sdf)
    solid = grid.solid
    if not solid.any():
        return np.zeros(sdf.shape, np.float32)
    centers = grid.centers_of(solid).astype(np.float32)
    score = _score(rays, silhouettes, torch.from_numpy(centers).to(rays.radiance.device)).cpu().numpy()
    free = np.zeros_like(solid)
    free[solid] = score < EXCESS_SHARE * np.nanmedian(score)  # False where no view sees the cell
    labels, _ = ndimage.label(free)
    free &= np.bincount(labels.ravel())[labels] >= LEAST_EXCESS
    return np.where(free, distances_to(solid & ~free, grid.cell) - sdf, 0.0).astype(np.float32)


def _score(
    rays: PixelRays,
    silhouettes: list[torch.Tensor],
    points: torch.Tensor,
    share: float = LOWEST_SHARE,
    values: int = 1 << 22,
) -> torch.Tensor:
    """The `share` quantile [n] of the silhouette values at points [n, 3], over the views that see the point.

    NaN where no view does. About `values` silhouette values are held in memory at a time.
    """
    scores = []
    for part in points.split(max(1, min(1 << 15, values // len(silhouettes)))):
        samples = []
        for view, silhouette in enumerate(silhouettes):
            place, ahead = rays.project(view, part)
            sample = functional.grid_sample(silhouette[None, None], place[None, :, None], align_corners=False)[0, 0, :, 0]
            seen = ahead & (place.abs() < 1).all(-1)
            samples.append(torch.where(seen, sample, torch.nan))
        scores.append(low_quantile(torch.stack(samples), share))
    return torch.cat(scores)


def low_quantile(values: torch.Tensor, share: float) -> torch.Tensor:
    """torch.nanquantile(values, share, dim=0) of values [views, n]; NaN where all are NaN.

    For a small share it is faster, because it sorts only the smallest values.
    """
    known = ~values.isnan()
    number = known.sum(0)
    most = min(math.floor(share * (len(values) - 1)) + 2, len(values))
    lowest = torch.where(known, values, torch.inf).T.contiguous().topk(most, largest=False).values
    place = share * (number - 1).clamp(min=0).to(values.dtype)
    below = place.floor().long()
    above = (below + 1).clamp(max=most - 1)
    low, high = lowest.gather(1, below[:, None])[:, 0], lowest.gather(1, above[:, None])[:, 0]
    # `high` is infinite if `low` is the largest known value. Then lerp gives NaN.
    mixed = torch.where(place > below, torch.lerp(low, high, place - below), low)
    return torch.where(number > 0, mixed, torch.nan)
