"""Fits materials to groups of photo samples. A hypothesis is a metallic value and a roughness; its best albedo is computed.

For a given roughness and metallic, the radiance of a pixel is linear in its albedo. So the albedo is found in closed form,
by reweighted least squares in the tone-mapped space, which is robust against outliers.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from blender_nep.ops.materials.material_fit import FitHypotheses, FitRoughness, FitSamples, fit_albedos
from blender_nep.profiling import profiled
from blender_nep.shading import brdf
from blender_nep.tone_mapping import tone_map

if TYPE_CHECKING:
    from blender_nep.shading.light_moments import LightMoments

_ROUGHNESS = 28
"""Steps of the roughness scan, evenly in sqrt(roughness)."""
_ITERATIONS = 4
"""Iterations of the reweighted least squares."""
_LEAST_KNOWN = 0.25
"""If the samples' mean weight by what photos show is smaller, they count alike. Measured share of the light that photos
show: 0.1 on two turntables, 0.6 and 0.7 after walks around the same objects."""


def roughness_scan(least: float, device: torch.device) -> Tensor:
    """The roughness values [R] that are tried, from `least` to 1; they are denser where lobes are narrow."""
    return torch.linspace(least**0.5, 1, _ROUGHNESS, device=device) ** 2


def place_in_scan(roughness: Tensor, least: float) -> Tensor:
    """The place [n] in 0 .. R - 1 of roughness values [n] in `roughness_scan`, the nearest one if they are outside."""
    return ((roughness.sqrt() - least**0.5) / (1 - least**0.5)).clamp(0, 1) * (_ROUGHNESS - 1)


def roughness_at(place: Tensor, least: float) -> Tensor:
    """The inverse of `place_in_scan`: the roughness [n] at places [n] of `roughness_scan`."""
    return (least**0.5 + (1 - least**0.5) * place / (_ROUGHNESS - 1)) ** 2


def place_of_least(values: Tensor) -> Tensor:
    """Where each column of values [R, K] is least: a place [K] in 0..R-1, refined by a parabola through three rows."""
    j, each = values.argmin(0), torch.arange(values.shape[1], device=values.device)
    inner = j.clamp(1, len(values) - 2)
    left, middle, right = (values[inner + k, each] for k in (-1, 0, 1))
    curve = left - 2 * middle + right
    shift = torch.where((curve > 1e-9) & (j == inner), 0.5 * (left - right) / curve.clamp_min(1e-9), 0.0)
    return j + shift.clamp(-0.5, 0.5)


def between(values: Tensor, place: Tensor) -> Tensor:
    """The values [R, K, ...] at a place [K] in 0..R-1 of each column, linear between the rows: [K, ...]."""
    low = place.long().clamp(0, len(values) - 2)
    each = torch.arange(len(place), device=place.device)
    share = (place - low).reshape(-1, *[1] * (values.ndim - 2)).to(values.dtype)
    return torch.lerp(values[low, each], values[low + 1, each], share)


def weight_of_known_light(light: LightMoments) -> Tensor:
    """Weight [n] of the samples: 0.05 + the share of a sample's reflected light that the photos show.

    The narrower half of the roughness levels counts: wide lobes see much that no photo shows, and tell little.
    """
    return 0.05 + light.coverage[:, : light.coverage.shape[1] // 2].mean(1)


def weight_of_found_light(light: LightMoments) -> Tensor:
    """As `weight_of_known_light`, once the light that no photo shows is found, too.

    If photos show little of the light, as on a turntable, reflections have told nearly all of it. Then the few samples that
    reflect the rest are no better than the others, and all count alike.
    """
    weight = weight_of_known_light(light)
    return weight if float(weight.mean()) >= _LEAST_KNOWN else weight.min().expand_as(weight)


def regions(position: np.ndarray, width: float) -> tuple[np.ndarray, np.ndarray]:
    """The region [n] int64 of each position [n, 3], a cube of this width, and the number of positions in each region."""
    voxel = np.floor(position / width).astype(np.int64)
    _, inverse, count = np.unique(voxel, axis=0, return_inverse=True, return_counts=True)
    return inverse.ravel(), count


@profiled("fits")
def fit_groups(
    light: LightMoments,
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
    """Fit every hypothesis (one of M metallic values, one of R roughness values) to every group of samples.

    target [n, 3] linear; weight [n]; group [n] int64 in 0..groups-1, or -1 for a sample in no group. `most_diffuse` is the
    largest albedo of a dielectric: a limit above 1 keeps the hue where F_e is too dark. Returns cost [M, R, groups] (mean
    clipped residual) and albedo [M, R, groups, 3]. The fit runs on the CPU, whatever the device.
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
    """The values as the kernel needs them: float32, contiguous, on the CPU."""
    return values.float().cpu().contiguous().numpy()
