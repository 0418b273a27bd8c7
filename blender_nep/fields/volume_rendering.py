"""Volume rendering of the object field: places the samples, and computes NeuS weights (Wang et al. 2021) in log space."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch

from blender_nep.profiling import profiled, section

if TYPE_CHECKING:
    from blender_nep.fields.object_field import SplineShape

BAND = 6.0
"""Samples are placed where |sharpness * sdf| < BAND. The opacity that is left out is sigmoid(-6) = 0.0025."""


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
    sdf_gradient: torch.Tensor
    """[m, k + 1, 3] gradient of the SDF at every sample, for the eikonal term"""
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


def neus_weights(sdf: torch.Tensor, sharpness: float) -> torch.Tensor:
    """Weights [n, k] of the k sections between k + 1 ordered samples of the SDF [n, k + 1].

    alpha = 1 - phi(f_{i+1}) / phi(f_i), where phi is the logistic function. It is computed from differences of log-sigmoids,
    and so it is exact deep inside the object. There both phi vanish, and the published (p - n + 1e-5) / (p + 1e-5) tends to
    1 although alpha does not.
    """
    log_phi = torch.nn.functional.logsigmoid(sharpness * sdf)
    delta = (log_phi[:, 1:] - log_phi[:, :-1]).clamp(max=0)
    before = torch.nn.functional.pad(torch.cumsum(delta[:, :-1], 1), (1, 0))
    return before.exp() * -torch.expm1(delta)


def place_samples(spans: torch.Tensor, count: torch.Tensor, samples: int, jitter: torch.Tensor) -> torch.Tensor:
    """Ordered distances [m, samples + 1], spread evenly over each ray's spans.

    spans [m, s, 2] are starts and ends of distances along the rays, of which the first count [m] are used; jitter [m] is in
    0..1.
    """
    length = (spans[..., 1] - spans[..., 0]).clamp(min=0)
    length = length * (torch.arange(spans.shape[1], device=spans.device) < count[:, None])
    end = length.cumsum(1)
    inner = (torch.arange(samples - 1, device=spans.device) + jitter[:, None]) / (samples - 1)
    u = torch.cat([torch.zeros_like(inner[:, :1]), inner, torch.ones_like(inner[:, :1])], 1) * end[:, -1:]
    which = (u[..., None] > end[:, None, :]).sum(-1).clamp(max=spans.shape[1] - 1)
    which = torch.minimum(which, (count[:, None] - 1).long())
    before = (end - length).gather(1, which)
    return spans[..., 0].gather(1, which) + (u - before)


@profiled("object field")
def render_surface(
    shape: SplineShape,
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
    weights = neus_weights(field[..., 0], sharpness)
    opacity = weights.sum(1)
    # gradient and distance of a section are the means of its two ends
    share = 0.5 * torch.nn.functional.pad(weights, (1, 0)) + 0.5 * torch.nn.functional.pad(weights, (0, 1))
    gradient = (share[..., None] * field[..., 1:4]).sum(1)
    depth = (share * t).sum(1) / opacity.clamp(min=1e-6)
    point = origins[ray] + depth[:, None] * directions[ray]
    return SurfaceSamples(ray, opacity, point, gradient, field[..., 1:4], depth)
