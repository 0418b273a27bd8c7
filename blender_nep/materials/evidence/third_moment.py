"""Finds the roughness of colored dielectrics from the part of the photos in which their diffuse light does not show.

A dielectric reflects light in the hue of the light, and its diffuse light has the hue of its albedo. So the radiance is
projected on the hue of the light, at right angles to the hue of the diffuse light (as in Mallick et al., Beyond Lambert,
CVPR 2005). What remains is reflected light alone. Errors of the irradiance and of the shape change the brightness of the
diffuse light, which hides the reflections elsewhere. Here, they hardly show.

Two things tell the roughness in this channel. The residual is least where the predicted reflections fit. But reflections
are never quite in place, so the residual favors blur. The third moment of the reflected light does not depend on where the
reflections are, and symmetric noise adds nothing to it. So the residual gives a range. Within it, the third moment decides.

With the true roughness, the predicted third moment is still wrong, by up to 23 % in `balanced` jobs and by up to 38 % in
`preview` jobs. The reason is not known. It is too large for some paints, and too small for others. So the
paints of an object share a roughness, except those whose third moment is far from that of the photos with a common one. And
among lobes so sharp that their third moments hardly differ, the residual decides.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from blender_nep.materials.evidence.protocol import Evidence, FittedMaterials, OfRoughness
from blender_nep.materials.fitting import roughness_scan, weight_of_found_light
from blender_nep.messages import Message, Part
from blender_nep.profiling import profiled
from blender_nep.shading.plenoptic import Material, affine_in_albedo

if TYPE_CHECKING:
    from blender_nep.presets import MaterialPreset
    from blender_nep.shading.light_moments import LightMoments

_LEAST_SAMPLES = 8
"""Least number of samples in a region."""
_LEAST_OF_MATERIAL = 100
"""Least number of samples of a material, in regions that are large enough."""
_LEAST_HUE = 0.15
"""Least sine of the angle between the hues of the light and of the diffuse light. A white or gray paint has less."""
_MOST_NOISE = 2 / 3
"""Largest share of noise in what varies. More than that is found in dull paints, and where one material stands for several
paints. Measured: 0.13 to 0.64 for ten paints of roughness 0.04 to 0.67, 0.76 for one of 0.18; 0.69 and 0.86 for a vase in
forty paints; 1.0 for paints of roughness 0.66 and 0.69."""
_LOBE = 0.3
"""Roughness of the lobe whose light tells the hue of the light."""
_ITERATIONS = 4
"""Iterations of the reweighted least squares."""
_SMALLEST = 0.01
"""Smaller residuals count quadratically, larger ones linearly."""
_TAIL = 0.005
"""This share of the largest and of the smallest values is clipped before third powers are taken."""
_LEAST_MOMENT = 1e-6
"""Smaller cube roots of third moments, and negative ones, count as this. They tell nothing."""
_WELL_EXPLAINED = 0.3
"""How much higher the residual is without reflections, as a share of the least residual. Where it is higher by more, the
range of the residual is wider in proportion, because then the third moment is that of reflections. Measured: 0.4 to 0.9 for
paints whose third moment helps, and 0.01 to 0.25 for four paints whose third moment misleads."""


class ThirdMoment(Evidence):
    """The third moment of the light that colored dielectrics reflect."""

    name = Part.THIRD_MOMENT

    def skipped(self, fitted: FittedMaterials) -> Message | None:
        return None if fitted.dielectrics else Message("reason.all_metal")

    def of_roughness(self, fitted: FittedMaterials) -> dict[int, OfRoughness]:
        found = {}
        for k in fitted.dielectrics:
            own = fitted.samples_of(k)
            told = evidence_of_colored(
                fitted.light, fitted.target, own, fitted.region_of(own), fitted.albedo[k], fitted.preset
            )
            if told is not None:
                found[k] = told
        return found


@profiled("roughness by hue")
def evidence_of_colored(
    light: LightMoments, target: Tensor, samples: Tensor, region: Tensor, albedo: Tensor, preset: MaterialPreset
) -> OfRoughness | None:
    """What tells a dielectric's roughness, from its `samples` [m] (indices). None if nothing does.

    The cost is the residual in this channel, divided by the least one. What is above 1 is smaller where reflections explain
    much of what the photos show, so that more values are possible there. The measure is the cube root of the third moment.

    Nothing does if the material is gray, dull, or painted in several colors, or if there are too few samples. target [n, 3]
    linear; region [m] int64, the region of the surface in which each of the samples lies; albedo [3].
    """
    large = torch.bincount(region)[region] >= _LEAST_SAMPLES
    if int(large.sum()) < _LEAST_OF_MATERIAL:
        return None
    samples = samples[large]
    channel = _DiffuseFree(light, target[samples], samples, albedo, region[large])
    if channel.hue < _LEAST_HUE or channel.noise(preset.clip) > _MOST_NOISE:
        return None
    scan = roughness_scan(preset.least_roughness, target.device)
    reflected = [channel.reflected(roughness) for roughness in scan]
    residual = torch.stack([channel.residual(each, preset.clip) for each in reflected])
    explained = float(channel.residual(torch.zeros_like(channel.shown), preset.clip) / residual.min().clamp_min(1e-9)) - 1
    if explained <= 0:
        return None  # the predicted reflections explain nothing
    photo = channel.third_moment(channel.shown)
    if photo <= _LEAST_MOMENT:
        return None  # what the photos show is not the light of lamps
    log_ratio = np.log([channel.third_moment(each) / photo for each in reflected])
    above_least = residual / residual.min().clamp_min(1e-9) - 1
    cost = 1 + above_least / max(1.0, explained / _WELL_EXPLAINED)
    return OfRoughness(cost, log_ratio.tolist().__getitem__)


class _DiffuseFree:
    """The channel of m samples in `region` [m] in which their diffuse light is 0."""

    def __init__(self, light: LightMoments, target: Tensor, samples: Tensor, albedo: Tensor, region: Tensor) -> None:
        self.light, self.samples, self.region = light, samples, region
        self.weight = weight_of_found_light(light)[samples]
        self.slope = 1 / (1 + 4 * target.mean(-1))
        """[m] how much a difference in radiance counts, as in the tone mapping"""
        diffuse = light.diffuse[samples] * albedo
        self.even_slope = 1 / (1 + 4 * diffuse.mean(-1))
        """[m] the same for the third moments. `slope` is small where the photo shows a highlight, and not where a misplaced
        one is predicted, so it would make the predicted moment too large"""
        own = torch.nn.functional.normalize(diffuse, dim=-1)
        lobe = light.moments(torch.full((len(samples),), _LOBE, device=target.device), samples)
        of_light = torch.nn.functional.normalize(lobe.full, dim=-1)
        across = of_light - (of_light * own).sum(-1, keepdim=True) * own
        self.hue = float(across.norm(dim=-1).median())
        """Median sine of the angle between the hues of the light and of the diffuse light"""
        self.direction = torch.nn.functional.normalize(across, dim=-1)
        self.brightness = diffuse.norm(dim=-1)
        self.shown = (target * self.direction).sum(-1)
        """[m] what the photos show in the channel"""
        self.neither = (target * torch.linalg.cross(own, self.direction)).sum(-1)
        """[m] what the photos show in the channel in which neither diffuse nor reflected light shows"""

    def reflected(self, roughness: Tensor) -> Tensor:
        """The reflected light [m] in the channel, with a scalar roughness."""
        one = torch.ones(len(self.samples), device=roughness.device)
        material = Material(torch.zeros(len(one), 3, device=one.device), roughness * one, 0 * one)
        moments = self.light.moments(material.roughness, self.samples)
        light, _ = affine_in_albedo(material, moments, self.light.diffuse[self.samples], self.light.cos_v[self.samples])
        return (light * self.direction).sum(-1)

    def noise(self, clip: float) -> float:
        """How much the channel varies in which there should be no light, as a share of how much this one varies."""
        return float(self._variation(self.neither, clip) / self._variation(self.shown, clip).clamp_min(1e-9))

    def residual(self, reflected: Tensor, clip: float) -> Tensor:
        """Mean absolute difference from the photos, if each region may have diffuse light of a slightly other hue."""
        return self._variation(self.shown - reflected, clip)

    def _variation(self, values: Tensor, clip: float) -> Tensor:
        """Mean absolute deviation of values [m] from the best share of the diffuse light in each region, clipped."""
        share, weight = torch.zeros_like(values), self.weight * self.slope
        for _ in range(_ITERATIONS):
            robust = weight * self.slope / ((values - share * self.brightness).abs() * self.slope).clamp_min(_SMALLEST)
            above = self._by_region(robust * values * self.brightness)
            share = (above / self._by_region(robust * self.brightness**2).clamp_min(1e-12))[self.region]
        error = ((values - share * self.brightness).abs() * self.slope).clamp_max(clip)
        return (error * self.weight).sum() / self.weight.sum()

    def third_moment(self, values: Tensor) -> float:
        """Cube root of the third central moment of values [m] within the regions; at least _LEAST_MOMENT."""
        values = values * self.even_slope
        mean = self._by_region(self.weight * values) / self._by_region(self.weight)
        values = values - mean[self.region]
        low, high = np.quantile(values.cpu().numpy(), [_TAIL, 1 - _TAIL])
        moment = (values.clamp(float(low), float(high)) ** 3 * self.weight).sum() / self.weight.sum()
        return max(float(np.cbrt(float(moment))), _LEAST_MOMENT)

    def _by_region(self, values: Tensor) -> Tensor:
        return torch.zeros(int(self.region.max()) + 1, device=values.device).index_add_(0, self.region, values)
