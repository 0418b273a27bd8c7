"""The colors of the support plane as a texture, whoever found them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import torch
from torch import Tensor
from torch.nn import functional

from blender_nep.capture.rays.ray_bundle import RayBundle
from blender_nep.support.plane import Support


@dataclass(frozen=True, eq=False)
class PlaneTexture:
    """A square of [n, n] texels along the support's axes, around the plane's point nearest to the sphere's center.

    Stages 1 and 2 make their own: only once the mesh is known can each photo that sees past it count (`light`); before, only
    colors on which the photos agree are surely the plane's (`agreed_colors`).
    """

    support: Support
    half_side: float
    """Half of the square's side, in object radii"""
    color: Tensor
    """[n, n, 3] linear radiance. Row 0 and column 0 lie at the negative ends of the axes"""
    known: Tensor
    """[n, n] bool"""

    @cached_property
    def axes(self) -> tuple[Tensor, Tensor, Tensor]:
        """The plane's normal [3], and the axes [3] along the rows' numbers and along the columns'."""
        normal, across, along = (
            torch.as_tensor(axis, dtype=self.color.dtype, device=self.color.device)
            for axis in (self.support.normal, *self.support.axes())
        )
        return normal, across, along

    def place(self, points: Tensor) -> Tensor:
        """Where points [n, 3] of the plane lie in the square: column and row [n, 2], each in -1..1."""
        _, across, along = self.axes
        return torch.stack([points @ along, points @ across], -1) / self.half_side

    def before(self, background: Callable[[RayBundle], Tensor]) -> Callable[[RayBundle], Tensor]:
        """The background (its radiance [n, 3] for rays [n]) with the known part of the plane before it."""
        return lambda rays: self.shown(rays, background(rays))

    def shown(self, rays: RayBundle, radiance: Tensor) -> Tensor:
        """The radiance [n, 3] of rays [n], where those that meet a known texel in the unit sphere show its color instead of
        `radiance`."""
        points, color, known = self.met(rays)
        return torch.where((known & (points.norm(dim=-1) < 1))[:, None], color, radiance)

    def met(self, rays: RayBundle) -> tuple[Tensor, Tensor, Tensor]:
        """Where rays [n] meet the plane [n, 3], the texture's color there [n, 3], and whether it is a known one [n] bool.

        It is not for rays that come from below.
        """
        normal = self.axes[0]
        cosine = rays.directions @ normal
        t = (self.support.height - rays.origins @ normal) / cosine.clamp(max=-1e-6)
        points = rays.origins + t[:, None] * rays.directions
        texels = torch.cat([self.color, self.known[..., None].to(self.color.dtype)], -1).permute(2, 0, 1)[None]
        found = functional.grid_sample(texels, self.place(points)[None, :, None], align_corners=False)[0, :, :, 0].T
        return points, found[:, :3], (found[:, 3] > 0.99) & (cosine < -1e-6) & (t > 0)

    def filled(self) -> PlaneTexture:
        """The texture without unknown texels: they get the mean of the known ones around. n is a power of two."""
        return replace(self, color=filled(self.color, self.known), known=torch.ones_like(self.known))


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
