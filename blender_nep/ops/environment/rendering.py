"""Differentiable volume rendering of the environment field: chooses the Numba or the torch body by device."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from blender_nep.ops.environment import (
    rendering_numba as environment_rendering_numba,
)
from blender_nep.ops.environment import (
    rendering_torch as environment_rendering_torch,
)
from blender_nep.ops.environment.samples import Medium, sample_rays
from blender_nep.ops.environment.segments import RaySegments
from blender_nep.ops.precision import at_least_float32


@dataclass(frozen=True)
class EnvironmentVolume:
    """The constants that give a spherical grid its meaning, and the settings of marching rays through it."""

    contraction_radius: float
    """Beyond this radius, shells lie at equal steps of 1 / |x|; unit frame, above 1"""
    density_gain: float
    """Factor of softplus(raw density): optical depth per unit of the contracted coordinate w (`segments`)"""
    longest_step: float
    """Longest step of a ray in w"""
    gradient_near: float = 0.0
    """Nearer to the camera than this, gradients are scaled by (t / gradient_near)^2, because samples are denser there and
    fewer photos see the place (Philip and Deschaintre 2023, "Floaters No More"). 0: no scaling"""
    transmittance_limit: float = 1e-4
    """The Numba body ends a ray when its transmittance falls to this value"""
    depth_limit: float = 1e-5
    """Samples with a smaller optical depth count as clear"""


class RenderedSegments(NamedTuple):
    """What n ray segments show."""

    radiance: Tensor
    """[n, 3] premultiplied, linear"""
    transmittance: Tensor
    """[n]"""
    distortion: Tensor
    """[n] in 0..1: how far the light of a segment is spread along it. It is 0 if all comes from one place. This is eq. 15 of
    mip-NeRF 360 (Barron et al. 2022). Places on the ray are those of w, in units of the length from |x| = 1 to infinity"""


def render_environment(
    raw: Tensor,
    detail: Tensor,
    segments: RaySegments,
    volume: EnvironmentVolume,
    *,
    jitter: Tensor | None = None,
    body: str = "auto",
) -> RenderedSegments:
    """Radiance, transmittance and distortion of ray segments through a spherical grid; differentiable in the grids.

    Args:
        raw: [K, H, W, 4] raw density (softplus, times density_gain, per unit of w) and log radiance.
        detail: [D, 2 D, 3] color detail, D >= 2 H: what is added to the log radiance of all shells, by direction from the
            center. It has more rows than the shells. Or D = 0: there is no color detail.
        segments: n segments.
        jitter: [n] in [0, 1), or None for the middle of each step.
        body: "auto" (Numba on the CPU, torch elsewhere), "numba" or "torch".
    """
    raw, detail, *parts = at_least_float32(raw, detail, *segments)
    with torch.no_grad():
        rays = sample_rays(RaySegments(*parts), volume.contraction_radius, volume.longest_step, jitter)
    medium = Medium(
        volume.contraction_radius,
        volume.density_gain,
        volume.gradient_near,
        volume.transmittance_limit,
        volume.depth_limit,
    )
    if body == "torch" or (body == "auto" and raw.device.type != "cpu"):
        return RenderedSegments(*environment_rendering_torch.render(raw, detail, rays, medium))
    return RenderedSegments(*environment_rendering_numba.render(raw, detail, rays, medium))
