"""Every hypothesis (metal or not, roughness) for groups of photo samples, each with the albedo that explains them best.

Given roughness and the choice metal or dielectric, the radiance of a pixel is linear in its albedo: solved in closed form,
robustly, by reweighted least squares in the photometric space.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from blender_nep.ops.material_fit import FitHypotheses, FitRoughness, FitSamples, fit_albedos
from blender_nep.profiling import profiled
from blender_nep.shading import brdf
from blender_nep.tone_mapping import tone_map

if TYPE_CHECKING:
    from blender_nep.shading.incoming_light import IncomingLight

_ROUGHNESS = 28
"""Steps of the roughness scan, evenly in sqrt(roughness)."""
_ITERATIONS = 4
"""Of the reweighted least squares."""


def roughness_scan(least: float, device: torch.device) -> Tensor:
    """Roughnesses tried, finer where lobes are narrow."""
    return torch.linspace(least**0.5, 1, _ROUGHNESS, device=device) ** 2


@profiled("fits")
def fit_groups(
    light: IncomingLight,
    target: Tensor,
    weight: Tensor,
    group: Tensor,
    groups: int,
    *,
    least_roughness: float,
    clip: float,
    hypotheses: tuple[float, ...] = (0.0, 1.0),
    most_diffuse: float = 1.0,
) -> tuple[Tensor, Tensor]:
    """Every hypothesis (metallic, roughness) for every group of samples.

    target [n,3] linear, weight [n], group [n] int64 in 0..groups-1 (-1: none); most_diffuse: limit of
    a dielectric's albedo (above 1 the hue survives where F_e is too dark).
    Returns cost [M,R,groups] (mean clipped residual) and albedo [M,R,groups,3]. Computed on the CPU, whatever the device.
    """
    scan = roughness_scan(least_roughness, target.device)
    member = (group >= 0).nonzero().squeeze(-1)
    member = member[group[member].argsort(stable=True)]
    ends = torch.bincount(group[member], minlength=groups).cumsum(0)
    cos_v, r = light.cos_v[member][:, None], scan[None]
    single = brdf.specular_albedo(cos_v, r)
    samples = FitSamples(
        specular=_array(light.specular[member]),
        diffuse=_array(light.diffuse[member]),
        goal=_array(target[member]),
        tone_goal=_array(tone_map(target[member])),
        weight=_array(weight[member]),
        ratio=_array((1 - single) / single),
        specular_scale=_array(brdf.multiscatter_scale(brdf.DIELECTRIC_FSS, cos_v, r)),
        diffuse_scale=_array(1 - brdf.dielectric_albedo(cos_v, r)),
    )
    low, mix = light.roughness_interval(scan)
    roughness = FitRoughness(low.cpu().numpy(), mix.cpu().numpy(), brdf.average_specular_albedo(scan).cpu().numpy())
    limits = [1.0 if metallic > 0.5 else most_diffuse for metallic in hypotheses]
    cost = np.zeros((len(hypotheses), len(scan), groups), np.float32)
    albedo = np.zeros((*cost.shape, 3), np.float32)
    fit_albedos(
        np.concatenate([[0], ends.cpu().numpy()]),
        samples,
        roughness,
        FitHypotheses(np.array(hypotheses, np.float32), np.array(limits, np.float32)),
        clip,
        _ITERATIONS,
        cost,
        albedo,
    )
    return torch.from_numpy(cost).to(target.device), torch.from_numpy(albedo).to(target.device)


def _array(values: Tensor) -> np.ndarray:
    """As the kernel reads it: float32, contiguous, on the CPU."""
    return values.float().cpu().contiguous().numpy()
