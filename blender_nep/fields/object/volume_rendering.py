"""Volume rendering of the object field: finds where rays are near the surface, and composites samples there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import torch

from blender_nep.ops.object.surface_rendering import composite, place_samples
from blender_nep.profiling import profiled, section

BAND = 6.0
"""Samples are placed where |sharpness * sdf| < BAND. The opacity that is left out is sigmoid(-6) = 0.0025."""


class MarchedShape(Protocol):
    """An SDF in the unit sphere, as far as its rendering needs it."""

    @property
    def cell(self) -> float:
        """Size of the SDF's finest cells in object radii"""

    def march(
        self,
        origins: torch.Tensor,
        directions: torch.Tensor,
        start: torch.Tensor,
        end: torch.Tensor,
        band: float,
        step: float,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Where rays [n, 3] are nearer than `band` to the surface: spans of distances, and whether there are any."""

    def sample(self, points: torch.Tensor) -> torch.Tensor:
        """The SDF and its gradient [n, 4] at points [n, 3]."""


@dataclass
class SurfaceSamples:
    """The surface that m rays meet, composited along each ray."""

    ray: torch.Tensor
    """[m] int64: indices of the rays"""
    opacity: torch.Tensor
    """[m] opacity of the object"""
    point: torch.Tensor
    """[m, 3] point at `depth` on the ray"""
    gradient: torch.Tensor
    """[m, 3] weighted sum of the SDF's gradients"""
    eikonal: torch.Tensor
    """[m] mean of (|gradient of the SDF| - 1)^2 over the samples of a ray"""
    depth: torch.Tensor
    """[m] weighted mean distance along the ray"""


def sphere_interval(origins: torch.Tensor, directions: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Distances [n] at which each ray enters and leaves the unit sphere, clipped to >= 0; equal where the ray misses it.

    Computed from the distance between ray and center. The usual b^2 - |o|^2 + 1 would lose digits: from 100 radii away, it
    is a difference of numbers 10,000 times larger, of which float32 leaves three digits.
    """
    along = -(origins * directions).sum(-1)
    closest = origins + along[:, None] * directions
    root = (1 - (closest * closest).sum(-1)).clamp(min=0).sqrt()
    return (along - root).clamp(min=0), (along + root).clamp(min=0)


@profiled("object field")
def render_surface(
    shape: MarchedShape,
    origins: torch.Tensor,
    directions: torch.Tensor,
    sharpness: float,
    samples: int,
    generator: torch.Generator | None,
    interval: tuple[torch.Tensor, torch.Tensor] | None = None,
) -> SurfaceSamples:
    """Composite the SDF's surface along rays [n, 3]. Rays that meet no surface are left out of the result.

    Samples are placed only where the surface can be: in the band |sharpness * sdf| < BAND, which marching finds. `interval`
    are the distances [n] between which the surface is looked for; by default, those between which a ray is in the sphere.
    """
    entry, leave = interval or sphere_interval(origins, directions)
    step = max(0.5 * shape.cell, 0.25 * BAND / sharpness)
    with section("march"):
        spans, count = shape.march(origins, directions, entry, leave, BAND / sharpness, step)
    ray = count.nonzero()[:, 0]
    jitter = (
        torch.full((len(ray),), 0.5, device=origins.device)
        if generator is None
        else torch.rand(len(ray), generator=generator, device=origins.device)
    )
    t = place_samples(spans[ray], count[ray], samples, jitter)
    points = origins[ray, None] + t[..., None] * directions[ray, None]
    field = shape.sample(points.reshape(-1, 3)).reshape(len(ray), samples + 1, 4)
    found = composite(field, t, sharpness)
    point = origins[ray] + found.depth[:, None] * directions[ray]
    return SurfaceSamples(ray, found.opacity, point, found.gradient, found.eikonal, found.depth)
