"""The residual: how well the predicted reflections fit the photos.

It is the only evidence that says something of every material. It tells the class by the least residual that each class can
have. For the roughness, its costs are

- **of a metal** those of all its samples.
- **of a dielectric** those of its reflections alone. How much of a dielectric's light comes from below its coat depends on
  the albedo and on the irradiance, and small errors of the irradiance are as strong as the whole reflection. So each
  material has an albedo of its own in each small region of the surface. What is left to compare between the photos of a
  region is the reflection. These albedos are not used for anything else. A sample counts as far as its reflected light is in
  the photos: the unseen light is too coarse to tell a roughness.
- **of a segment**, where materials vary, those of the segments around it: a segment has few samples.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from blender_nep.materials.evidence.protocol import Evidence, FittedMaterials, OfMetallic, OfRoughness
from blender_nep.materials.fitting import fit_groups, weight_of_found_light
from blender_nep.messages import Message, Part
from blender_nep.profiling import profiled

if TYPE_CHECKING:
    from blender_nep.presets import MaterialPreset
    from blender_nep.shading.light_moments import LightMoments

_LEAST_SAMPLES = 8
"""Least number of samples in a region. With fewer, its three albedos would follow the noise."""
_NO_LIMIT = 2.5
"""Largest regional albedo. It is above 1, because F_e may be too dark in a region."""
_ROUGHNESS_SEGMENTS, _ROUGHNESS_REACH = 48, 3.3
"""Number of the near segments whose residuals tell the roughness, and the distance at which their weight falls to 1/e."""
_CLASS_SEGMENTS, _CLASS_REACH = 12, 1.5
"""The same for the class: metal or dielectric."""
_LEAST_RESIDUAL = 1e-3
"""It is added to residuals before a logarithm is taken, so that samples without any error do not decide all."""
_OTHER_CLASS = 1e-3
"""Weight of segments of the other class when the roughness is chosen. It is not 0, for a segment may be alone."""
NEAR_SEGMENTS = _ROUGHNESS_SEGMENTS
"""Number of the near segments that `SegmentResidual` needs."""


class Residual(Evidence):
    """The residual of each hypothesis."""

    name = Part.RESIDUAL

    def skipped(self, fitted: FittedMaterials) -> Message | None:
        return None

    def of_metallic(self, fitted: FittedMaterials) -> OfMetallic:
        least = fitted.cost.amin(1)
        other = least.sort(0).values  # the share by which the residual grows if the class with the least residual is wrong
        share = (other[1] / other[0].clamp_min(1e-9) - 1).tolist() if len(other) > 1 else []
        return OfMetallic(least, {k: {"other_class": round(value, 4)} for k, value in enumerate(share)})

    def of_roughness(self, fitted: FittedMaterials) -> dict[int, OfRoughness]:
        metal = {
            k: OfRoughness(fitted.cost[fitted.preset.metallic.index(float(fitted.metallic[k])), :, k]) for k in fitted.metals
        }
        dielectrics = fitted.dielectrics
        if not dielectrics:
            return metal
        among = (fitted.metallic < 0.5)[fitted.label]
        label = torch.where(among, fitted.label, -1)
        cost, weight = residual_of_reflections(
            fitted.light, fitted.target, fitted.position, label, len(fitted), fitted.preset
        )
        return metal | {k: OfRoughness(cost[:, k], weight=weight[k]) for k in dielectrics if weight[k] > 0}


@profiled("roughness")
def residual_of_reflections(
    light: LightMoments,
    target: Tensor,
    position: np.ndarray,
    label: Tensor,
    materials: int,
    preset: MaterialPreset,
) -> tuple[Tensor, Tensor]:
    """The residual of each of the K materials, as a dielectric, at the R values of `roughness_scan`, with regional albedos.

    target [n, 3] linear; position [n, 3] in the unit frame; label [n] int64 in 0..K-1, or -1 for a sample that does not
    count. Returns the mean residual [R, K] and the weight of the samples [K] that it comes from; 0 where no region has
    enough samples.
    """
    weight = weight_of_found_light(light)
    voxel = np.floor(position / preset.region).astype(np.int64)
    place = np.concatenate([label.cpu().numpy()[:, None], voxel], 1)
    region, inverse, count = np.unique(place, axis=0, return_inverse=True, return_counts=True)
    used = (count >= _LEAST_SAMPLES) & (region[:, 0] >= 0)
    group = torch.from_numpy(np.where(used, np.arange(len(count)), -1)[inverse.ravel()]).to(target.device)
    cost, _ = fit_groups(
        light,
        target,
        weight,
        group,
        len(count),
        least_roughness=preset.least_roughness,
        clip=preset.clip,
        hypotheses=(0.0,),
        most_diffuse=_NO_LIMIT,
    )
    inside = group >= 0
    mass = torch.zeros(len(count), device=target.device).index_add_(0, group[inside], weight[inside])
    material = torch.from_numpy(region[used, 0]).to(target.device)
    mass, own = mass[torch.from_numpy(used)], (cost[0] * mass).T[torch.from_numpy(used)]
    total = torch.zeros(materials, device=target.device).index_add_(0, material, mass)
    summed = torch.zeros(materials, cost.shape[1], device=target.device).index_add_(0, material, own)
    return (summed / total.clamp_min(1e-9)[:, None]).T, total


@dataclass(frozen=True, eq=False)
class SegmentResidual:
    """The residuals of K segments, and the S >= NEAR_SEGMENTS segments that are nearest to each."""

    cost: np.ndarray
    """[M, R, K] of each hypothesis"""
    mass: np.ndarray
    """[K] weight of the samples of each segment"""
    distance: np.ndarray
    """[K, S]"""
    index: np.ndarray
    """[K, S] int"""

    def of_metallic(self, margin: np.ndarray) -> np.ndarray:
        """Costs [M, K] of the classes, whose residuals are multiplied by margin [M].

        They are mean logarithms of the residuals, each at the segment's own best roughness: a roughness that suits its
        neighbors may hide what it is. The mean logarithm is the likelihood of errors with a Laplace distribution whose scale
        differs from segment to segment.
        """
        count = np.arange(self.index.shape[1]) < _CLASS_SEGMENTS
        close = self.mass[self.index] * np.exp(-((self.distance / _CLASS_REACH) ** 2)) * count
        log_residual = np.log(margin[:, None] * (self.cost.min(1) + _LEAST_RESIDUAL))
        return _averaged(log_residual, close, self.index)

    def of_roughness(self, chosen: np.ndarray, prior: float) -> np.ndarray:
        """Costs [K, R] of the roughness values with the chosen classes [K]: means over near segments of the same class.

        The mean over the whole object is added with the weight `prior`: it decides where the photos of a place hardly tell
        the roughness.
        """
        near = self.mass[self.index] * np.exp(-((self.distance / _ROUGHNESS_REACH) ** 2))
        same = near * np.where(chosen[self.index] == chosen[:, None], 1, _OTHER_CLASS)
        cost = _averaged(self.cost, same, self.index)[chosen, :, np.arange(len(chosen))]
        for k in np.unique(chosen):
            members = np.flatnonzero(chosen == k)
            cost[members] += prior * _averaged(self.cost[k], self.mass[members], members)
        return cost


def _averaged(values: np.ndarray, weight: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Weighted means of values [..., K] over the segments index [..., near], with weight [..., near]."""
    return (values[..., index] * weight).sum(-1) / np.maximum(weight.sum(-1), 1e-9)
