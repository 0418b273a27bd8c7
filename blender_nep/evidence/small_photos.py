"""Small tone-mapped photos, in which the colors of points are compared quickly."""

from __future__ import annotations

import copy
import math

import torch
from scipy.ndimage import gaussian_filter
from torch import Tensor
from torch.nn import functional

from blender_nep.capture.rays.pixel_rays import PixelRays
from blender_nep.evidence.observation import chosen_views, colors_of, observe
from blender_nep.evidence.occluders import MeshOccluder
from blender_nep.geometry.ray_tracing import RayTracer
from blender_nep.tone_mapping import tone_map

_VIEWS, _ROWS = 40, 200
"""Largest number of photos that are compared, and the rows and columns to which they are resized."""
_FACING = 0.15
"""A small photo shows a surface if the cosine of the viewing angle is above this. At smaller ones, the point falls elsewhere
in the photo if the surface is a little higher or lower."""


class SmallPhotos:
    """At most 40 small tone-mapped photos, interpolated between their pixels."""

    def __init__(self, rays: PixelRays) -> None:
        self.rays = rays
        self.views = chosen_views(rays.views, _VIEWS)
        photos = []
        for view in self.views:
            height, width = rays.size[view]
            index = torch.arange(rays.offset[view], rays.offset[view + 1], device=rays.radiance.device)
            photo = tone_map(rays.photo(index)).reshape(1, height, width, 3).permute(0, 3, 1, 2)
            photos.append(functional.adaptive_avg_pool2d(photo, (_ROWS, _ROWS)))
        self.photos = torch.cat(photos)

    @property
    def cameras(self) -> Tensor:
        """[views, 3] positions of the cameras."""
        return torch.stack([self.rays.camera(view)[0] for view in self.views])

    @property
    def half_angle(self) -> Tensor:
        """[views] half angles of the cones of the small photos' pixels, in radians: those of the pixels in the middle."""
        rays, sizes = self.rays, [self.rays.size[view] for view in self.views]
        middle = [
            rays.offset[view] + height // 2 * width + width // 2
            for view, (height, width) in zip(self.views, sizes, strict=True)
        ]
        wider = torch.tensor([math.sqrt(height * width) / _ROWS for height, width in sizes], device=self.photos.device)
        return rays.rays(torch.tensor(middle, device=self.photos.device)).half_angle * wider

    def details(self, fine: float) -> SmallPhotos:
        """The same photos without what changes slowly over them. What is left has both signs.

        fine: the standard deviation, in rows of the small photos, of the blur that is taken away.

        A glossy table mirrors other surroundings for each camera. That changes slowly, and the table's pattern does not.
        """
        other = copy.copy(self)
        blurred = gaussian_filter(self.photos.cpu().numpy(), (0, 0, fine, fine), mode="nearest")
        other.photos = self.photos - torch.from_numpy(blurred).to(self.photos.device)
        return other

    def sample(self, view: int, place: Tensor) -> Tensor:
        """Colors [k, 3] of a photo at image coordinates [k, 2] within -1..1."""
        photo = self.photos[self.views.index(view)][None]
        return functional.grid_sample(photo, place[None, :, None], align_corners=False)[0, :, :, 0].T

    def colors(self, points: Tensor) -> Tensor:
        """Colors [views, n, 3] of points [n, 3] that nothing hides; NaN where they are not in the frame.

        The same as `observe` gives without an occluder, but in one step, for searches that ask thousands of times.
        """
        found = [self.rays.project(view, points) for view in self.views]
        place, ahead = (torch.stack(part) for part in zip(*found, strict=True))
        colors = functional.grid_sample(self.photos, place[:, :, None], align_corners=False)[..., 0].transpose(1, 2)
        seen = ahead & (place.abs() < 1).all(-1)
        return torch.where(seen[..., None], colors, torch.nan)

    def surface_colors(self, points: Tensor, normals: Tensor, surface: RayTracer, inexact: float) -> Tensor:
        """Colors [views, n, 3] of points [n, 3] of a surface with normals [n, 3]; NaN where a photo does not show the point.

        inexact: how far the surface may be from where it is said to be, in the unit frame. It hides nothing within that.
        Points and result lie on the CPU.
        """
        device = self.photos.device
        seen = observe(
            self, points.to(device), normals.to(device), MeshOccluder(surface), least_cosine=_FACING, lift=inexact
        )
        return colors_of(seen, len(points)).cpu()
