"""The input of both bodies of the environment's volume rendering: sampled rays, and the constants of the medium."""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor

from blender_nep.ops.environment.segments import RaySegments, contract_segments

MAXIMUM_STEPS = 512


class RaySamples(NamedTuple):
    """n rays, and the samples on them: at equal steps of the coordinate w of `segments`.

    The fields are tensors. For the Numba kernels, they are NumPy arrays.
    """

    origins: Tensor
    """[n, 3]"""
    directions: Tensor
    """[n, 3] unit length"""
    t_closest: Tensor
    """[n] float64, like b, w_near and w_length; see `ContractedSegments`"""
    b: Tensor
    w_near: Tensor
    w_length: Tensor
    infinite: Tensor
    """[n] bool: whether the ray ends in the outermost shell, the sky"""
    offsets: Tensor
    """[n + 1] int64: ray i has offsets[i + 1] - offsets[i] samples: one for each step, and one more if it is infinite"""
    jitter: Tensor
    """[n] in [0, 1): place of the sample within each step"""


class Medium(NamedTuple):
    """Constants of the medium, and limits below which light is neglected."""

    contraction_radius: float
    """Beyond this radius, shells lie at equal steps of 1 / |x|"""
    density_gain: float
    """Density per unit of dw for a softplus of 1"""
    gradient_near: float
    """Distance t below which gradients are scaled by (t / gradient_near)^2; 0 for no scaling"""
    transmittance_limit: float
    """The Numba body ends a ray when its transmittance falls to this value"""
    depth_limit: float
    """Samples with a smaller optical depth count as clear"""


def sample_rays(segments: RaySegments, contraction_radius: float, longest_step: float, jitter: Tensor | None) -> RaySamples:
    """Place samples on ray segments, in steps of at most `longest_step` in w.

    A ray has at most MAXIMUM_STEPS steps; a longer ray has longer steps. jitter: [n] in [0, 1), or None for the middle of
    each step.
    """
    contracted = contract_segments(segments, contraction_radius)
    infinite = torch.isinf(segments.t_far)
    steps = torch.ceil(contracted.w_length / longest_step).long().clamp_max(MAXIMUM_STEPS)
    offsets = steps.new_zeros(len(steps) + 1)
    torch.cumsum(steps + infinite.long(), 0, out=offsets[1:])
    if jitter is None:
        jitter = torch.full_like(segments.t_near, 0.5)
    return RaySamples(segments.origins, segments.directions, *contracted, infinite, offsets, jitter)
