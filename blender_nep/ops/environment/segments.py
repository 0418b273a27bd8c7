"""Ray segments in the contracted coordinate of the environment's spherical volume.

The volume is contracted as in mip-NeRF 360 (Barron et al. 2022): inside the contraction radius R its shells lie at equal
steps of log |x|, so that near things have the same resolution in angle and in distance. Outside R the shells lie at equal
steps of disparity 1 / |x|, because that is what parallax shows of far things. The last shell, the sky, lies at infinity:

    u(|x|) = log |x| for |x| <= R,    u(|x|) = log R + 1 - R / |x| for |x| > R,    u(infinity) = log R + 1.

Density is given per unit of dw = dt / |x| * min(1, R / |x|). For a ray through the center, dw = du. Let a straight ray come
nearest to the origin at t_c, with the distance b. Then w integrates in closed form, counted from that point:

    inside R:   t = t_c + b sinh(w),   |x| = b cosh(w)
    outside R:  t = t_c + b / tan(z),  |x| = b / sin(z),  where the angle z falls linearly in w, from asin(b / R) to 0.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from torch import Tensor

MINIMUM_CLOSEST_APPROACH = 1e-3
"""Smallest b, in the unit frame. A ray through the origin itself would have infinite length in w."""


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


class ContractedSegments(NamedTuple):
    """n ray segments in the contracted coordinate w. All [n] float64."""

    t_closest: Tensor
    """Distance along the ray of the point that is closest to the origin; there w = 0"""
    b: Tensor
    """Distance of that point from the origin, at least MINIMUM_CLOSEST_APPROACH"""
    w_near: Tensor
    """w at which the segment begins"""
    w_length: Tensor
    """Length of the segment in w, >= 0"""


def contracted_length(contraction_radius: float) -> float:
    """u of the sky: the length in w of a ray from the unit sphere to infinity, away from the center."""
    return math.log(contraction_radius) + 1


def contracted_radius(u: Tensor, contraction_radius: float) -> Tensor:
    """The inverse of u(|x|): distances from the center, for u in 0 .. contracted_length. The sky's is inf."""
    beyond = (contracted_length(contraction_radius) - u).clamp_min(0)
    return torch.where(beyond >= 1, torch.exp(u), contraction_radius / beyond)


def far_share(u: Tensor, contraction_radius: float) -> Tensor:
    """Share of the color detail at contracted distances: 0 inside the contraction radius, 1 beyond twice that radius."""
    return (2 * (u - math.log(contraction_radius))).clamp(0, 1)


def contract_segments(segments: RaySegments, contraction_radius: float) -> ContractedSegments:
    """Ray segments in the contracted coordinate w."""
    origins, directions, t_near, t_far = (part.double() for part in segments)
    t_closest = -(origins * directions).sum(-1)
    closest = origins + t_closest[:, None] * directions
    b = closest.norm(dim=-1).clamp_min(MINIMUM_CLOSEST_APPROACH)
    w_near = _contract(t_near - t_closest, b, contraction_radius)
    w_far = _contract(t_far - t_closest, b, contraction_radius)
    return ContractedSegments(t_closest, b, w_near, (w_far - w_near).clamp_min(0.0))


def _contract(t: Tensor, b: Tensor, contraction_radius: float) -> Tensor:
    """w at the distances t from the closest point, t and b [n]."""
    border = (b / contraction_radius).clamp_max(1)
    z_border, w_border = torch.asin(border), torch.acosh(1 / border)
    z = torch.atan2(b, t.abs())
    beyond = w_border + (contraction_radius / b) * (z_border - z)
    w = torch.where(z < z_border, beyond, torch.asinh((t.abs() / b).clamp_max(1e8)))
    return torch.where(t < 0, -w, w)
