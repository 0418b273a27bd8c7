"""Where a ray is sampled in the environment's spherical volume.

The volume is scale-invariant: far away it is as fine, in angle and in the logarithm of the distance, as close by. Its
density is therefore given per unit of ds = dt / |x(t)|. Along a straight ray with distance of closest approach b to the
origin, reached at t_c, this integrates in closed form: t = t_c + b sinh(s), |x(t)| = b cosh(s). Equal steps in s are
what "a step proportional to the distance" means, and optical depth is density times a step in s.
"""

from __future__ import annotations

import torch

MINIMUM_CLOSEST_APPROACH = 1e-3
"""b is not let below this (unit radii): a ray through the origin itself would have infinite length in s."""


def scale_invariant_segments(
    origins: torch.Tensor, directions: torch.Tensor, t_near: torch.Tensor, t_far: torch.Tensor, outer_radius: float
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Segments [t_near, t_far] of rays in the coordinate s; an infinite t_far becomes the exit from the outer radius.

    Args:
        origins, directions: [n, 3], directions of unit length.
        t_near, t_far: [n] distances along the ray; t_far may be inf. t_far <= t_near is an empty segment.
        outer_radius: radius of the outermost shell.

    Returns:
        t_c [n], b [n], s_near [n], s_length [n] >= 0, all float64.
    """
    origins, directions = origins.double(), directions.double()
    t_near, t_far = t_near.double(), t_far.double()
    t_closest = -(origins * directions).sum(-1)
    closest = origins + t_closest[:, None] * directions
    b = closest.norm(dim=-1).clamp_min(MINIMUM_CLOSEST_APPROACH)
    t_exit = t_closest + (outer_radius**2 - b**2).clamp_min(0.0).sqrt()
    t_far = torch.where(torch.isinf(t_far), t_exit, torch.minimum(t_far, t_exit))
    s_near = torch.asinh((t_near - t_closest) / b)
    s_far = torch.asinh((t_far - t_closest) / b)
    return t_closest, b, s_near, (s_far - s_near).clamp_min(0.0)
