"""Ray segments in the scale-invariant coordinate s of the environment's spherical volume.

The volume is scale-invariant: in angle and in the logarithm of the distance, it has the same resolution far away and close
by. So its density is given per unit of ds = dt / |x(t)|. Let a straight ray come nearest to the origin at t_c, with the
distance b. Then ds integrates in closed form: t = t_c + b sinh(s), |x(t)| = b cosh(s). Equal steps in s are steps that are
proportional to the distance from the origin, and optical depth is density times a step in s.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

MINIMUM_CLOSEST_APPROACH = 1e-3
"""Smallest b, in the unit frame. A ray through the origin itself would have infinite length in s."""


class RaySegments(NamedTuple):
    """Segments t_near to t_far of n rays, in distances along the ray. With t_far <= t_near, a segment is empty."""

    origins: Tensor
    """[n, 3], unit frame"""
    directions: Tensor
    """[n, 3], unit length"""
    t_near: Tensor
    """[n]"""
    t_far: Tensor
    """[n]; where it is inf, the ray ends in the outermost shell, the sky"""


class ScaleInvariantSegments(NamedTuple):
    """n ray segments in the coordinate s: t = t_closest + b sinh(s), |x| = b cosh(s). All [n] float64."""

    t_closest: Tensor
    """Distance along the ray of the point that is closest to the origin"""
    b: Tensor
    """Distance of that point from the origin, at least MINIMUM_CLOSEST_APPROACH"""
    s_near: Tensor
    """s at which the segment begins"""
    s_length: Tensor
    """Length of the segment in s, >= 0"""


def scale_invariant_segments(segments: RaySegments, outer_radius: float) -> ScaleInvariantSegments:
    """Ray segments in the coordinate s. They end at the latest where the ray leaves the sphere of `outer_radius`."""
    origins, directions, t_near, t_far = (part.double() for part in segments)
    t_closest = -(origins * directions).sum(-1)
    closest = origins + t_closest[:, None] * directions
    b = closest.norm(dim=-1).clamp_min(MINIMUM_CLOSEST_APPROACH)
    t_exit = t_closest + (outer_radius**2 - b**2).clamp_min(0.0).sqrt()
    t_far = torch.where(torch.isinf(t_far), t_exit, torch.minimum(t_far, t_exit))
    s_near = torch.asinh((t_near - t_closest) / b)
    s_far = torch.asinh((t_far - t_closest) / b)
    return ScaleInvariantSegments(t_closest, b, s_near, (s_far - s_near).clamp_min(0.0))
