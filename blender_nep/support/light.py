"""The light of the support plane in the object's sphere: what the object sees of the table on which it stands.

F_e knows the table from the unit sphere outwards. The disc of the table inside the sphere is neither F_e nor object. Photos
show it, with the object's shadow on it. Each texel of the disc takes the median of its colors in the photos that see it past
the object. The texture is prefiltered, so that cones of any width can be queried (mipmaps, Williams 1983).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from blender_nep.evidence.agreement import median_color, views_that_show
from blender_nep.evidence.full_photos import FullPhotos, Sampling
from blender_nep.evidence.observation import colors_of, observe
from blender_nep.evidence.occluders import MeshOccluder
from blender_nep.evidence.sdf_grid import cell_centers
from blender_nep.geometry.ray_tracing import RayTracer
from blender_nep.profiling import profiled
from blender_nep.support.plane import Support

if TYPE_CHECKING:
    from blender_nep.capture.rays.pixel_rays import PixelRays

TEXELS = 128
"""Texels along each side of the square that is textured."""
SIDE = 1.2
"""The square's half side, in radii of the disc. It is larger than the disc, because wide cones reach beyond the rim."""
LEAST_PHOTOS = 3
"""A texel that fewer photos show takes the color of the texels around it."""
LEAST_COSINE = 0.1
"""Smallest cosine between the plane's normal and the direction to the camera; other photos show the texel too blurred."""
MOST_PHOTOS = 80
"""Largest number of photos that are used. This bounds the memory."""


class SupportLight:
    """The prefiltered radiance of the support plane in the unit sphere."""

    def __init__(self, support: Support, radiance: Tensor) -> None:
        """radiance [T, T, 3], linear; T is a power of two. Row 0 and column 0 lie at the negative ends of the axes."""
        device = radiance.device
        self.support, self.side = support, SIDE * support.radius
        self.normal, self.across, self.along = (
            torch.as_tensor(axis, dtype=torch.float32, device=device) for axis in (support.normal, *support.axes())
        )
        level = radiance.permute(2, 0, 1)[None]
        self.levels = [level]
        while level.shape[-1] > 1:
            level = functional.avg_pool2d(level, 2)
            self.levels.append(level)

    @classmethod
    @profiled("support light")
    def of(cls, support: Support, rays: PixelRays, tracer: RayTracer) -> SupportLight | None:
        """The light of the plane as the photos show it. None if the plane misses the sphere, or if no photo shows the disc.

        The object's mesh in `tracer` tells which photos see a texel.
        """
        if support.radius == 0:
            return None
        colors = _texel_colors(support, rays, tracer)
        seen = views_that_show(colors) >= LEAST_PHOTOS
        if not seen.any():
            return None
        grid = torch.where(seen[:, None], median_color(colors), 0).reshape(TEXELS, TEXELS, 3)
        return cls(support, filled(grid, seen.reshape(TEXELS, TEXELS)))

    def query_cone(self, origins: Tensor, directions: Tensor, half_angle: Tensor) -> tuple[Tensor, Tensor]:
        """Mean radiance [n, 3] of the plane in cones of half_angle [n] radians, and which meet it in the sphere [n] bool.

        origins [n, 3] lie in the unit sphere. The radiance is 0 for the other cones.
        """
        cosine = -(directions @ self.normal)
        height = origins @ self.normal - self.support.height
        t = height.clamp_min(0) / cosine.clamp_min(1e-6)
        point = origins + t[:, None] * directions
        meets = (cosine > 1e-6) & (height > -1e-3) & (point.square().sum(-1) < 1)
        radiance = torch.zeros_like(origins)
        row = meets.nonzero()[:, 0]
        if len(row):
            # the cone's footprint is an ellipse; its area is that of a disc of this diameter
            width = 2 * t[row] * half_angle[row].clamp_max(1.5).tan() / cosine[row].sqrt()
            place = torch.stack([point[row] @ self.along, point[row] @ self.across], -1) / self.side
            radiance[row] = self._filtered(place, width)
        return radiance, meets

    def _filtered(self, place: Tensor, width: Tensor) -> Tensor:
        """Radiance [n, 3] at places [n, 2] in -1..1, averaged over `width` [n] in the unit frame, between two levels."""
        texels = width * (self.levels[0].shape[-1] / (2 * self.side))
        level = texels.clamp_min(1).log2().clamp_max(len(self.levels) - 1.001)
        low = level.long()
        out = place.new_zeros(len(place), 3)
        for k, texture in enumerate(self.levels):
            share = (low == k) * (1 - level.frac()) + (low == k - 1) * level.frac()
            row = (share > 0).nonzero()[:, 0]
            if len(row):
                sample = functional.grid_sample(
                    texture, place[row][None, :, None], padding_mode="border", align_corners=False
                )
                out[row] += share[row, None] * sample[0, :, :, 0].T
        return out


def _texel_centers(support: Support) -> np.ndarray:
    """Centers [TEXELS^2, 3] of the texels, row by row."""
    line = cell_centers(TEXELS) * SIDE * support.radius
    across, along = support.axes()
    points = line[:, None, None] * across + line[None, :, None] * along + support.height * np.asarray(support.normal)
    return points.reshape(-1, 3).astype(np.float32)


def _texel_colors(support: Support, rays: PixelRays, tracer: RayTracer) -> Tensor:
    """Linear radiance [views, TEXELS^2, 3] of the texels in the photos; NaN where a photo does not show them."""
    points = torch.from_numpy(_texel_centers(support)).to(rays.radiance.device)
    normal = np.asarray(support.normal)
    above = normal.astype(np.float32) * 10 * tracer.offset  # the object may touch the plane
    normals = torch.from_numpy(normal).to(points.device).expand(len(points), 3)
    photos = FullPhotos(rays, Sampling.TO_THE_EDGE, MOST_PHOTOS)
    seen = observe(photos, points, normals, MeshOccluder(tracer, above=above), least_cosine=LEAST_COSINE)
    return colors_of(seen, len(points))


def filled(grid: Tensor, known: Tensor) -> Tensor:
    """A grid [T, T, 3] whose texels are known where `known` [T, T]; the others get the mean of the known ones around them.

    T is a power of two. The mean is taken on the finest coarser level that knows something there.
    """
    weight = known.to(grid.dtype)[None, None]
    value = grid.permute(2, 0, 1)[None] * weight
    if grid.shape[0] == 1:
        return grid
    share = functional.avg_pool2d(weight, 2)
    mean = functional.avg_pool2d(value, 2) / share.clamp_min(1e-9)
    coarse = filled(mean[0].permute(1, 2, 0), share[0, 0] > 0)
    wide = functional.interpolate(coarse.permute(2, 0, 1)[None], scale_factor=2, mode="bilinear", align_corners=False)
    return torch.where(known[..., None], grid, wide[0].permute(1, 2, 0))
