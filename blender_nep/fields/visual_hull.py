"""Where the object is, before anything is known of it: the photos do not look like their background there.

F_e is learned first, alone, from the pixels whose rays miss the object's sphere. What it predicts for the other pixels
is right where they see through the sphere and wrong where they see the object: the residual is a soft silhouette, and
space carving (Kutulakos and Seitz 2000) with it gives the object's visual hull. Nothing has to be segmented. With
masks, the masks are the silhouettes.

A start near the truth lets the surface be sharp at once: a soft one has time to explain highlights by dents, and a
small sphere does not reach thin parts before it is sharp.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy import ndimage
from skimage.filters import threshold_otsu
from torch.nn import functional

from blender_nep.capture.pixel_rays import PixelRays
from blender_nep.fields.environment_field import EnvironmentField
from blender_nep.tone_mapping import tone_map

LOWEST_SHARE = 0.05
"""A point is as much object as this quantile of its silhouette values says: nearly all views must agree."""
LEAST_COMPONENT = 0.02
"""Components smaller than this share of the largest are dropped."""
LEAST_VOLUME, MOST_VOLUME = 0.002, 0.7
"""Of the sphere; a hull outside these bounds is no object."""


@dataclass
class VisualHull:
    """A carved hull. sdf [n, n, n] at the centres of n^3 cells of [-1, 1]^3, unit frame; volume: share of the sphere;
    contrast: mean silhouette value inside over that outside, well above 1 where there is an object."""

    sdf: np.ndarray
    volume: float
    contrast: float


def background_silhouettes(environment: EnvironmentField, rays: PixelRays, block: int = 4) -> list[torch.Tensor]:
    """Per view [H / block, W / block]: mean absolute tone-mapped difference between the photo and F_e alone."""
    near = environment.preset.camera_near
    # made first: between the large arrays of a loop they would keep the heap from reusing those
    maps = [torch.empty(max(h // block, 1), max(w // block, 1), device=rays.radiance.device) for h, w in rays.size]
    for view, (height, width) in enumerate(rays.size):
        start, end = rays.offset[view], rays.offset[view + 1]
        rows, columns = maps[view].shape
        row = torch.arange(rows, device=rays.radiance.device) * height // rows + min(block // 2, height - 1)
        column = torch.arange(columns, device=rays.radiance.device) * width // columns + min(block // 2, width - 1)
        index = (start + row[:, None] * width + column).flatten()
        origins, directions, half_angle = rays.rays(index)
        t = torch.full_like(half_angle, near)
        with torch.no_grad():
            radiance, _ = environment.render(origins, directions, t, torch.full_like(t, torch.inf), half_angle)
        photo = rays.photo(torch.arange(start, end, device=rays.radiance.device)).reshape(height, width, 3)
        photo = functional.adaptive_avg_pool2d(tone_map(photo).permute(2, 0, 1), (rows, columns)).permute(1, 2, 0)
        maps[view].copy_((tone_map(radiance).reshape(rows, columns, 3) - photo).abs().mean(-1))
    return maps


def mask_silhouettes(rays: PixelRays, block: int = 4) -> list[torch.Tensor]:
    """Per view [H / block, W / block]: mean of the object mask. Raises ValueError for rays without masks."""
    if rays.mask is None:
        raise ValueError("silhouettes by masks need masks")
    maps = []
    for view, (height, width) in enumerate(rays.size):
        mask = rays.mask[rays.offset[view] : rays.offset[view + 1]].float().reshape(1, height, width) / 255
        maps.append(functional.adaptive_avg_pool2d(mask, (max(height // block, 1), max(width // block, 1)))[0])
    return maps


def carve(rays: PixelRays, silhouettes: list[torch.Tensor], cells: int) -> VisualHull | None:
    """The hull of soft silhouettes on cells^3, or None where they show no object."""
    axis = (np.arange(cells) + 0.5) / cells * 2 - 1
    centres = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1)
    in_sphere = np.linalg.norm(centres, axis=-1) < 1
    points = torch.from_numpy(centres[in_sphere].astype(np.float32)).to(rays.radiance.device)
    score = _score(rays, silhouettes, points).cpu().numpy()
    known = np.isfinite(score)
    if not known.any() or np.ptp(score[known]) < 1e-6:
        return None
    level = threshold_otsu(score[known])
    solid = np.zeros(in_sphere.shape, bool)
    solid[in_sphere] = np.nan_to_num(score) > level
    labels, count = ndimage.label(solid)
    if count == 0:
        return None
    size = np.bincount(labels.ravel())[1:]
    solid = np.isin(labels, 1 + np.flatnonzero(size >= LEAST_COMPONENT * size.max()))
    solid = ndimage.binary_fill_holes(solid)
    volume = solid.sum() / in_sphere.sum()
    if not LEAST_VOLUME <= volume <= MOST_VOLUME:
        return None
    above = known & solid[in_sphere]
    contrast = float(score[above].mean() / max(score[known & ~above].mean(), 1e-6)) if above.any() else 0.0
    # distances to the cells' centres: half a cell from each side to the border between them
    distance = ndimage.distance_transform_edt(~solid) - ndimage.distance_transform_edt(solid)
    distance = (distance - np.sign(distance) * 0.5) * (2 / cells)
    return VisualHull(ndimage.gaussian_filter(distance, 1.0).astype(np.float32), float(volume), contrast)


def _score(rays: PixelRays, silhouettes: list[torch.Tensor], points: torch.Tensor, values: int = 1 << 22) -> torch.Tensor:
    """The LOWEST_SHARE quantile [n] of the silhouettes' values at points [n, 3], over the views that see them. About
    `values` of them are held at a time."""
    scores = []
    for part in points.split(max(1, min(1 << 15, values // len(silhouettes)))):
        samples = []
        for view, silhouette in enumerate(silhouettes):
            place, ahead = rays.project(view, part)
            sample = functional.grid_sample(silhouette[None, None], place[None, :, None], align_corners=False)[0, 0, :, 0]
            seen = ahead & (place.abs() < 1).all(-1)
            samples.append(torch.where(seen, sample, torch.nan))
        scores.append(torch.nanquantile(torch.stack(samples), LOWEST_SHARE, dim=0))
    return torch.cat(scores)
