"""Finds how much light the person who takes the photos takes from the object (`shading.photographer`).

The person is in each photo somewhere else, and the material of a place stays the same. So the materials of small regions are
fitted to most photos under several strengths, and photos that were held out tell which strength is right. Wrong materials
make the residual larger, and hardly move its minimum.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from blender_nep.materials.evidence.held_out import FOLDS, standard_errors
from blender_nep.materials.fitting import fit_groups, regions
from blender_nep.materials.palette.palette import best_of, error
from blender_nep.profiling import profiled
from blender_nep.shading.photographer import STRENGTHS as KNOWN

if TYPE_CHECKING:
    from blender_nep.materials.samples.photo_samples import PhotoSamples
    from blender_nep.presets import MaterialPreset
    from blender_nep.shading.incoming_light import IncomingLight

STRENGTHS = (0.0, *KNOWN)
"""Strengths that are tried, evenly spaced"""
LEAST_GAIN = 0.01
"""A person counts if the held-out photos differ by this share less."""
LEAST_SURE, LEAST_PHOTOS = 2.0, 4
"""And if their mean gain with the smallest strength is so many times its standard error, in at least so many photos"""
_SAMPLES = 6000
"""Photo samples that are fitted and predicted"""
_REGION = 1.5
"""Width of the regions in which the material counts as one, in widths of the preset's regions: there are fewer samples"""


@profiled("photographer")
def found_strength(samples: PhotoSamples, light: IncomingLight, preset: MaterialPreset) -> tuple[float, dict[str, float]]:
    """How strong the person is, and {strength: error of held-out photos}. `light` may have a person of any strength.

    0 if nobody explains the photos clearly better, or if there are too few photos.
    """
    some = torch.linspace(0, len(samples) - 1, min(_SAMPLES, len(samples))).long().to(samples.photo.device)
    region, count = regions(samples.position[some.cpu().numpy()], _REGION * preset.region)
    group, groups = torch.from_numpy(region).to(some.device), len(count)
    target, even = samples.radiance[some], torch.ones(len(some), device=some.device)
    photo = samples.photo[some]
    held_out = [photo % FOLDS == fold for fold in range(FOLDS)]
    # Of a region that no other photo shows, nothing is predicted.
    told = [held & (torch.bincount(group[~held], minlength=groups) > 0)[group] for held in held_out]
    shown = torch.bincount(photo[torch.stack(told).any(0)])
    if int((shown > 0).sum()) < LEAST_PHOTOS:
        return 0.0, {}

    def error_of_photos(strength: float) -> Tensor:
        lit = light.moments_behind(strength - light.photographer, some)
        of_photo = torch.zeros(len(shown), dtype=torch.float64, device=some.device)
        for held, known in zip(held_out, told, strict=True):
            cost, albedo = fit_groups(
                lit,
                target,
                even,
                torch.where(held, -1, group),
                groups,
                least_roughness=preset.least_roughness,
                clip=preset.clip,
                hypotheses=preset.metallic,
            )
            material = best_of(cost, albedo, preset.least_roughness, preset.metallic, 1.0).at(group)
            of_photo.index_add_(0, photo[known], error(lit, target, even, material, preset.clip)[known].double())
        return of_photo

    errors = [error_of_photos(strength) for strength in STRENGTHS[:2]]
    sure = standard_errors(errors[0] - errors[1], shown) > LEAST_SURE
    if sure:  # otherwise nobody is there, whatever the others say
        errors += [error_of_photos(strength) for strength in STRENGTHS[2:]]
    means = [float(each.sum() / shown.sum()) for each in errors]
    tried = zip(STRENGTHS[: len(means)], means, strict=True)
    return _best(means) if sure else 0.0, {f"{strength:g}": round(mean, 5) for strength, mean in tried}


def _best(errors: list[float]) -> float:
    """The strength with the least error, refined by a parabola; 0 if it gains too little."""
    k = min(range(len(errors)), key=errors.__getitem__)
    if errors[k] > (1 - LEAST_GAIN) * errors[0]:
        return 0.0
    step = STRENGTHS[1] - STRENGTHS[0]
    if k == len(errors) - 1:
        return STRENGTHS[k]
    left, middle, right = errors[k - 1 : k + 2]
    return STRENGTHS[k] + 0.5 * step * (left - right) / max(left - 2 * middle + right, 1e-9)
