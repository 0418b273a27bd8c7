"""The spread of a metal's radiance about its mean tells the metal's roughness.

Normals are a little wrong, so reflections are misplaced. A misplaced reflection agrees best with a blurred one, and the
residual is least at a roughness that is too high. For mirrors the residual hardly changes there. How far the radiance
spreads about its mean does not depend on where the reflections are. Lobes that are sharper than the light all have the
spread of a mirror. If the photos vary more than a mirror would, the light or the shape lacks something that the photos show,
and the spread tells less.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from blender_nep.materials.evidence.protocol import Evidence, FittedMaterials, OfRoughness
from blender_nep.materials.fitting import roughness_scan, weight_of_found_light
from blender_nep.messages import Message, Part
from blender_nep.shading.plenoptic import Material, reflected

_LEAST_SAMPLES = 8
"""Least number of samples in a region. Fewer tell no spread."""
_LEAST_SPREAD = 1e-6
"""Smallest spread of the log radiance. It stands for 0, where no region has enough samples."""


class Spread(Evidence):
    """The spread of the radiance that a metal reflects."""

    name = Part.SPREAD

    def skipped(self, fitted: FittedMaterials) -> Message | None:
        return None if fitted.metals else Message("reason.no_metal")

    def of_roughness(self, fitted: FittedMaterials) -> dict[int, OfRoughness]:
        return {k: self._of_metal(fitted, k) for k in fitted.metals}

    def _of_metal(self, fitted: FittedMaterials, k: int) -> OfRoughness:
        light, own = fitted.light, fitted.samples_of(k)
        scan, region = roughness_scan(fitted.preset.least_roughness, own.device), fitted.region_of(own)
        weight = weight_of_found_light(light)[own]
        photo = fitted.target[own].mean(-1)
        darkest = 0.1 * photo.median().clamp_min(1e-6)  # what is darker says more about noise than about the light
        of_photo = max(spread(photo + darkest, weight, region), _LEAST_SPREAD)

        def log_ratio(row: int) -> float:
            roughness = scan[row].expand(len(own))
            material = Material(fitted.albedo[k].expand(len(own), 3), roughness, torch.ones_like(roughness))
            shown = reflected(material, light.moments(roughness, own), light.diffuse[own], light.cos_v[own]).mean(-1)
            return math.log(max(spread(shown + darkest, weight, region), _LEAST_SPREAD) / of_photo)

        return OfRoughness(log_ratio=log_ratio)


def spread(radiance: Tensor, weight: Tensor, region: Tensor) -> float:
    """Mean absolute deviation of the log radiance from its mean in each region; a change of exposure changes nothing.

    radiance [n] > 0, weight [n], region [n] int64. Regions of fewer than _LEAST_SAMPLES samples are left out; without any
    other region, the spread is 0.
    """
    values, count = torch.log(radiance), torch.bincount(region)
    total = torch.zeros(len(count), device=values.device).index_add_(0, region, weight)
    mean = torch.zeros(len(count), device=values.device).index_add_(0, region, weight * values) / total.clamp_min(1e-9)
    used = count[region] >= _LEAST_SAMPLES
    share = weight[used] / weight[used].sum().clamp_min(1e-9)
    return float((share * (values - mean[region])[used].abs()).sum())
