"""What both bodies of the environment's volume rendering are given: sampled rays and the medium's constants."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from blender_nep.ops.environment_segments import RaySegments, scale_invariant_segments

MAXIMUM_STEPS = 512


class RaySamples(NamedTuple):
    """n rays and where they are sampled: at equal steps of s, see `environment_segments`.

    The fields are tensors; for the Numba kernels they are the same as NumPy arrays.
    """

    origins: Tensor
    """[n, 3]"""
    directions: Tensor
    """[n, 3] unit length"""
    t_closest: Tensor
    """[n] float64, as are b, s_near and s_length"""
    b: Tensor
    s_near: Tensor
    s_length: Tensor
    infinite: Tensor
    """[n] bool: the outermost shell closes the ray"""
    offsets: Tensor
    """[n + 1] int64: ray i has offsets[i + 1] - offsets[i] samples, one a step, and one more where it is infinite"""
    jitter: Tensor
    """[n] in [0, 1): place of the sample within each step"""


class Medium(NamedTuple):
    """Constants of the medium, and what the Numba body may neglect."""

    log_radius: float
    """Logarithm of the outermost shell's radius"""
    density_gain: float
    """Density per unit of ds for a softplus of 1"""
    gradient_near: float
    """Distance t below which gradients are scaled by (t / gradient_near)^2; 0 for none"""
    transmittance_limit: float
    """A ray ends where less than this passes"""
    depth_limit: float
    """Samples of a smaller optical depth are skipped"""


def sample_rays(segments: RaySegments, outer_radius: float, relative_step: float, jitter: Tensor | None) -> RaySamples:
    """Samples of ray segments in steps of at most `relative_step`, a fraction of the distance from the origin.

    jitter: [n] in [0, 1); None for the middle of each step.
    """
    scaled = scale_invariant_segments(segments, outer_radius)
    infinite = torch.isinf(segments.t_far)
    steps = torch.ceil(scaled.s_length / relative_step).long().clamp_max(MAXIMUM_STEPS)
    offsets = steps.new_zeros(len(steps) + 1)
    torch.cumsum(steps + infinite.long(), 0, out=offsets[1:])
    if jitter is None:
        jitter = torch.full_like(segments.t_near, 0.5)
    return RaySamples(segments.origins, segments.directions, *scaled, infinite, offsets, jitter)
