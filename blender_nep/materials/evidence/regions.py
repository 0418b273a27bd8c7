"""Tells metal from dielectric by how well small regions of the surface predict photos that were held out.

A palette has few materials. So one of the wrong class may explain a varied object as well as the right one does. A region
has one material of its own: it is fitted to three of four photos as a metal and as a dielectric, and predicts the others. A
wrong shape or a wrong light speaks for one class everywhere: on embossed gold, regions say dielectric. So they say
something only of an object on which some materials are clearly metal, and others clearly not (docs/lab/metal-or-not.md).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from blender_nep.materials.evidence.held_out import FOLDS, standard_errors
from blender_nep.materials.evidence.protocol import Evidence, FittedMaterials, OfMetallic
from blender_nep.materials.fitting import between, fit_groups, place_of_least, regions, roughness_scan
from blender_nep.messages import Message, Part
from blender_nep.profiling import profiled
from blender_nep.shading.plenoptic import Material, reflected
from blender_nep.tone_mapping import tone_map

if TYPE_CHECKING:
    from blender_nep.presets import MaterialPreset
    from blender_nep.shading.light_moments import LightMoments

_WIDTH = 1.5
"""Width of a region, in widths of the preset's regions"""
_CLEAR = 0.1
"""Logarithm of the ratio of both classes' errors from which a material is clearly of one. On three captures with paint and
metal it is 0.17 to 0.3 and more in both directions."""
_SURE = 3.0
"""And it must be so many times its standard error over photos."""
_LEAST_SAMPLES = 50
"""Of a material with fewer samples, nothing is said."""


class Regions(Evidence):
    """How well regions predict held-out photos."""

    name = Part.REGIONS

    def skipped(self, fitted: FittedMaterials) -> Message | None:
        if len(fitted.preset.metallic) == 1:
            return Message("reason.class_chosen")
        return Message("reason.one_material") if len(fitted) == 1 else None

    def of_metallic(self, fitted: FittedMaterials) -> OfMetallic:
        said = class_by_regions(
            fitted.light, fitted.target, fitted.position, fitted.photo, fitted.label, len(fitted), fitted.preset
        )
        metallic = torch.tensor(fitted.preset.metallic, device=said.device)[:, None]
        told = {k: {"metal": value} for k, value in enumerate(said.tolist()) if value}
        # Twice what the hue says, because it must outweigh a hue that says the opposite.
        return OfMetallic(1 - 2 * fitted.preset.hue_margin * said * metallic, told)


@profiled("metal by regions")
def class_by_regions(
    light: LightMoments,
    target: Tensor,
    position: np.ndarray,
    photo: Tensor,
    group: Tensor,
    groups: int,
    preset: MaterialPreset,
) -> Tensor:
    """What regions say of each group of samples: 1 (metal), -1 (dielectric) or 0 (nothing), [groups].

    target [n, 3] linear; position [n, 3]; photo [n] int64; group [n] int64 in 0..groups-1, or -1 for a sample in no group.
    Nothing is said unless one group is clearly metal and another one clearly not.
    """
    dielectric, metal = _held_out_errors(light, target, position, photo, preset)
    said = [_clear_class(dielectric, metal, photo, group == k) for k in range(groups)]
    if min(said) != -1 or max(said) != 1:
        said = [0] * groups
    return torch.tensor(said, dtype=torch.float32, device=target.device)


def _held_out_errors(
    light: LightMoments, target: Tensor, position: np.ndarray, photo: Tensor, preset: MaterialPreset
) -> tuple[Tensor, Tensor]:
    """Errors [n] of dielectrics and of metals where a region predicts a photo; NaN where no other fold shows the region."""
    region, count = regions(position, _WIDTH * preset.region)
    own, even = torch.from_numpy(region).to(target.device), torch.ones(len(target), device=target.device)
    scan = roughness_scan(preset.least_roughness, target.device)
    classes = (min(preset.metallic), max(preset.metallic))
    errors = torch.full((2, len(target)), torch.nan, dtype=torch.float64, device=target.device)
    for fold in range(FOLDS):
        held = photo % FOLDS == fold
        told = held & (torch.bincount(own[~held], minlength=len(count)) > 0)[own]
        cost, albedo = fit_groups(
            light,
            target,
            even,
            torch.where(held, -1, own),
            len(count),
            least_roughness=preset.least_roughness,
            clip=preset.clip,
            hypotheses=classes,
        )
        for each, (metallic, residual, of_class) in enumerate(zip(classes, cost, albedo, strict=True)):
            place = place_of_least(residual)
            roughness = between(scan.sqrt()[:, None].expand(-1, len(count)), place) ** 2
            material = Material(between(of_class, place)[own], roughness[own], torch.full_like(even, metallic))
            predicted = reflected(material, light.moments(material.roughness), light.diffuse, light.cos_v)
            error = (tone_map(predicted) - tone_map(target)).abs().mean(-1).clamp_max(preset.clip)
            errors[each][told] = error[told].double()
    return errors[0], errors[1]


def _clear_class(dielectric: Tensor, metal: Tensor, photo: Tensor, chosen: Tensor) -> int:
    """1 if the chosen samples [n] bool are clearly predicted better as metal, -1 if as dielectric, else 0."""
    chosen = chosen & dielectric.isfinite()
    if int(chosen.sum()) < _LEAST_SAMPLES:
        return 0
    photo, gain = photo[chosen], (dielectric - metal)[chosen]
    ratio = float((dielectric[chosen].mean() / metal[chosen].mean().clamp_min(1e-9)).clamp_min(1e-9).log())
    sure = abs(standard_errors(torch.bincount(photo, gain), torch.bincount(photo))) > _SURE
    clear = abs(ratio) > _CLEAR and sure
    return (1 if ratio > 0 else -1) if clear else 0
