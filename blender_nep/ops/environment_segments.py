"""Where a ray is sampled in the environment's spherical volume.

The volume is scale-invariant: far away it is as fine, in angle and in the logarithm of the distance, as close by. Its
density is therefore given per unit of ds = dt / |x(t)|. Along a straight ray with distance of closest approach b to the
origin, reached at t_c, this integrates in closed form: t = t_c + b sinh(s), |x(t)| = b cosh(s). Equal steps in s are
what "a step proportional to the distance" means, and optical depth is density times a step in s.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

MINIMUM_CLOSEST_APPROACH = 1e-3
"""b is not let below this (unit radii): a ray through the origin itself would have infinite length in s."""


class RaySegments(NamedTuple):
    """The part [t_near, t_far] of n rays, in distances along the ray; t_far <= t_near is an empty segment."""

    origins: Tensor
    """[n, 3], unit frame"""
    directions: Tensor
    """[n, 3], unit length"""
    t_near: Tensor
    """[n]"""
    t_far: Tensor
    """[n]; where it is inf, the outermost shell closes the ray"""


class ScaleInvariantSegments(NamedTuple):
    """n ray segments in the coordinate s: t = t_closest + b sinh(s), |x| = b cosh(s). All [n] float64."""

    t_closest: Tensor
    """Distance along the ray of the point that is closest to the origin"""
    b: Tensor
    """Distance of that point from the origin"""
    s_near: Tensor
    """Where the segment begins"""
    s_length: Tensor
    """Length of the segment, >= 0"""


def scale_invariant_segments(segments: RaySegments, outer_radius: float) -> ScaleInvariantSegments:
    """Ray segments in the coordinate s; an infinite t_far becomes the exit from the sphere of `outer_radius`."""
    origins, directions, t_near, t_far = (part.double() for part in segments)
    t_closest = -(origins * directions).sum(-1)
    closest = origins + t_closest[:, None] * directions
    b = closest.norm(dim=-1).clamp_min(MINIMUM_CLOSEST_APPROACH)
    t_exit = t_closest + (outer_radius**2 - b**2).clamp_min(0.0).sqrt()
    t_far = torch.where(torch.isinf(t_far), t_exit, torch.minimum(t_far, t_exit))
    s_near = torch.asinh((t_near - t_closest) / b)
    s_far = torch.asinh((t_far - t_closest) / b)
    return ScaleInvariantSegments(t_closest, b, s_near, (s_far - s_near).clamp_min(0.0))
