"""Every hypothesis (metal or not, roughness) for groups of photo samples, each with the albedo that explains them best.

Given roughness and the choice metal or dielectric, the radiance of a pixel is linear in its albedo: solved in closed form,
robustly, by reweighted least squares in the photometric space.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from blender_nep.metrics import tone_map
from blender_nep.ops.material_fit import fit_lines
from blender_nep.profile import profiled
from blender_nep.shading import brdf
from blender_nep.shading.plenoptic import Material, albedo_line

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
def fit_groups(light: IncomingLight, target: Tensor, weight: Tensor, group: Tensor, groups: int, *,
               least_roughness: float, clip: float, hypotheses: tuple[float, ...] = (0.0, 1.0),
               most_diffuse: float = 1.0) -> tuple[Tensor, Tensor]:
    """Every hypothesis (metallic, roughness) for every group of samples.

    target [n,3] linear, weight [n], group [n] int64 in 0..groups-1 (-1: none); most_diffuse: limit of
    a dielectric's albedo (above 1 the hue survives where F_e is too dark).
    Returns cost [M,R,groups] (mean clipped residual) and albedo [M,R,groups,3].
    """
    scan = roughness_scan(least_roughness, target.device)
    member = (group >= 0).nonzero().squeeze(-1)
    fit = _fit_fused if target.device.type == "cpu" else _fit_batched
    return fit(light, target, weight, group, groups, member, scan, clip, hypotheses, most_diffuse)


def _fit_fused(light: IncomingLight, target: Tensor, weight: Tensor, group: Tensor, groups: int, member: Tensor,
               scan: Tensor, clip: float, hypotheses: tuple[float, ...], most_diffuse: float) -> tuple[Tensor, Tensor]:
    """On the CPU: samples in the order of their groups, each hypothesis of a group by itself."""
    member = member[group[member].argsort(stable=True)]
    ends = torch.bincount(group[member], minlength=groups).cumsum(0)
    cos_v, r = light.cos_v[member][:, None], scan[None]
    alone = brdf.specular_albedo(cos_v, r)
    low, mix = light.rung(scan)
    limits = [1.0 if metallic > 0.5 else most_diffuse for metallic in hypotheses]
    samples = (light.specular[member], light.diffuse[member], target[member], tone_map(target[member]), weight[member],
               (1 - alone) / alone, brdf.multiscatter_scale(brdf.DIELECTRIC_FSS, cos_v, r),
               1 - brdf.dielectric_albedo(cos_v, r))
    scanned = (low, mix, brdf.average_specular_albedo(scan))
    starts = torch.nn.functional.pad(ends, (1, 0))
    cost = torch.zeros(len(hypotheses), len(scan), groups)
    albedo = torch.zeros(len(hypotheses), len(scan), groups, 3)
    fit_lines(starts.numpy(), *(x.float().contiguous().numpy() for x in samples), *(x.numpy() for x in scanned),
              np.array(hypotheses, np.float32), np.array(limits, np.float32), clip, _ITERATIONS,
              cost.numpy(), albedo.numpy())
    return cost, albedo


def _fit_batched(light: IncomingLight, target: Tensor, weight: Tensor, group: Tensor, groups: int, member: Tensor,
                 scan: Tensor, clip: float, hypotheses: tuple[float, ...], most_diffuse: float) -> tuple[Tensor, Tensor]:
    """On any device: all samples at once, one hypothesis after the other."""
    group, goal, weight = group[member], target[member], weight[member]
    cos_v, diffuse, tone_goal = light.cos_v[member], light.diffuse[member], tone_map(goal)
    total = _sum(weight[:, None], group, groups).clamp_min(1e-9)
    cost = torch.zeros(len(hypotheses), len(scan), groups, device=target.device)
    albedo = torch.zeros(len(hypotheses), len(scan), groups, 3, device=target.device)
    for j, r in enumerate(scan):
        moments = light.moments(r, member)
        for i, metallic in enumerate(hypotheses):
            a = torch.full((groups, 3), 0.5, device=target.device)
            for k in range(_ITERATIONS + 1):
                own = Material(a[group], r.expand(len(goal)), torch.full_like(cos_v, metallic))
                offset, slope = albedo_line(own, moments, diffuse, cos_v)
                predicted = offset + slope * a[group]
                residual = tone_map(predicted) - tone_goal
                if k == _ITERATIONS:
                    break
                # d tone / d radiance turns the tone-mapped residual into a linear one; 1 / |residual| makes it L1.
                mean = 0.5 * (predicted.clamp_min(0) + goal) if k else goal
                robust = weight[:, None] / (1 + 4 * mean) ** 2
                if k:
                    robust = robust * (residual.abs() < 2 * clip) / residual.abs().clamp_min(0.02)
                top = _sum(robust * slope * (goal - offset), group, groups)
                bottom = _sum(robust * slope * slope, group, groups)
                a = (top / bottom.clamp_min(1e-12)).clamp(0, 1.0 if metallic > 0.5 else most_diffuse)
            bounded = residual.abs().mean(-1).clamp_max(clip) * weight
            cost[i, j] = _sum(bounded[:, None], group, groups)[:, 0] / total[:, 0]
            albedo[i, j] = a
    return cost, albedo


def _sum(values: Tensor, group: Tensor, groups: int) -> Tensor:
    return torch.zeros(groups, values.shape[1], device=values.device, dtype=values.dtype).index_add_(0, group, values)
