"""The light of the support plane in the object's sphere: what the object sees of the table on which it stands.

F_e knows the table from the unit sphere outwards. The disc of the table inside the sphere is neither F_e nor object. Photos
show it, with the object's shadow on it. Each texel of the disc takes the median of its colors in the photos that see it past
the object, without the plane's sheen (`sheen`). The texture is prefiltered, so that cones of any width can be queried
(mipmaps, Williams 1983).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from blender_nep.evidence.agreement import median_of_photos, views_that_show
from blender_nep.evidence.full_photos import FullPhotos, Sampling
from blender_nep.evidence.observation import Observation, colors_of, observe
from blender_nep.evidence.occluders import MeshOccluder
from blender_nep.evidence.sdf_grid import cell_centers
from blender_nep.geometry.ray_tracing import RayTracer
from blender_nep.profiling import profiled
from blender_nep.support.plane import Support
from blender_nep.support.sheen import BLACK, Sheen
from blender_nep.support.texture import PlaneTexture

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
_POINTS_OF_SHEEN = 7
"""Every seventh texel tells the sheen. The number is odd, so that it leaves out no columns."""
_STEP = 1.1
"""Factor between two radiances whose changes tell the contrast of a change of colors"""


class SupportLight:
    """The prefiltered radiance of the support plane in the unit sphere."""

    def __init__(self, texture: PlaneTexture, sheen: Sheen | None = None) -> None:
        """The texture's side is a power of two, and all its texels are known. With a sheen, its factors are left out."""
        self.texture, self.sheen = texture, sheen
        level = texture.color.permute(2, 0, 1)[None]
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
        texture, sheen = _texture_past_object(support, rays, tracer)
        return cls(texture.filled(), sheen) if texture.known.any() else None

    def with_colors(self, change: Callable[[Tensor], Tensor]) -> SupportLight:
        """The same plane with other colors: change(radiance [n, n, 3] of its finest texels)."""
        color = self.texture.color
        if self.sheen is None:
            return SupportLight(replace(self.texture, color=change(color)))
        usual = color.mean((0, 1)).clamp_min(BLACK)
        contrast = (change(usual * _STEP) / change(usual)).log() / math.log(_STEP)
        return SupportLight(replace(self.texture, color=change(color)), self.sheen.scaled(contrast))

    def query_cone(self, origins: Tensor, directions: Tensor, half_angle: Tensor) -> tuple[Tensor, Tensor]:
        """Mean radiance [n, 3] of the plane in cones of half_angle [n] radians, and which meet it in the sphere [n] bool.

        origins [n, 3] lie in the unit sphere. The radiance is 0 for the other cones.
        """
        normal, plane = self.texture.axes[0], self.texture.support
        cosine = -(directions @ normal)
        height = origins @ normal - plane.height
        t = height.clamp_min(0) / cosine.clamp_min(1e-6)
        point = origins + t[:, None] * directions
        meets = (cosine > 1e-6) & (height > -1e-3) & (point.square().sum(-1) < 1)
        radiance = torch.zeros_like(origins)
        row = meets.nonzero()[:, 0]
        if len(row):
            # the cone's footprint is an ellipse; its area is that of a disc of this diameter
            width = 2 * t[row] * half_angle[row].clamp_max(1.5).tan() / cosine[row].sqrt()
            radiance[row] = self._filtered(self.texture.place(point[row]), width)
            if self.sheen is not None:
                radiance[row] *= self.sheen.factor(-directions[row])
        return radiance, meets

    def _filtered(self, place: Tensor, width: Tensor) -> Tensor:
        """Radiance [n, 3] at places [n, 2] in -1..1, averaged over `width` [n] in the unit frame, between two levels."""
        texels = width * (self.levels[0].shape[-1] / (2 * self.texture.half_side))
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


def _texture_past_object(support: Support, rays: PixelRays, tracer: RayTracer) -> tuple[PlaneTexture, Sheen | None]:
    """The median of the texels' colors in the photos that see them past the object, where enough photos do; and the sheen.

    The colors are without the sheen. A turntable's plane turns below its light, so it has none.
    """
    square = support.square(cell_centers(TEXELS) * SIDE * support.radius).reshape(-1, 3)
    points = torch.from_numpy(square.astype(np.float32)).to(rays.radiance.device)
    normal = np.asarray(support.normal)
    above = normal.astype(np.float32) * 10 * tracer.offset  # the object may touch the plane
    normals = torch.from_numpy(normal).to(points.device).expand(len(points), 3)
    photos = FullPhotos(rays, Sampling.TO_THE_EDGE, MOST_PHOTOS)
    seen = list(observe(photos, points, normals, MeshOccluder(tracer, above=above), least_cosine=LEAST_COSINE))
    colors, sheen = colors_of(seen, len(points)), None
    if rays.turntable is None:
        towards = torch.stack([functional.normalize(camera - points, dim=-1) for camera in _cameras(rays, seen)])
        sheen = Sheen.of(colors[:, ::_POINTS_OF_SHEEN], towards[:, ::_POINTS_OF_SHEEN])
        if sheen is not None:
            colors = colors / sheen.factor(towards)
    known = views_that_show(colors) >= LEAST_PHOTOS
    color = torch.where(known[:, None], median_of_photos(colors), 0)
    size = TEXELS, TEXELS
    return PlaneTexture(support, SIDE * support.radius, color.reshape(*size, 3), known.reshape(size)), sheen


def _cameras(rays: PixelRays, seen: list[Observation]) -> list[Tensor]:
    """The place [3] of the camera of each observation."""
    return [rays.camera(of.view)[0].to(rays.radiance.device) for of in seen]
