"""Finds the strength of the camera's response curve from what the object reflects.

A photo shows the surroundings and their reflection through one curve. A surface that reflects half of the light darkens
bright and dark surroundings by one factor. A curve that compresses highlights makes this factor another one for bright than
for dark surroundings. So the photos of the object are predicted from those of the surroundings under several strengths, each
time with the materials that fit best, and the errors are compared in the photos' own values.

A pure power of the light cannot be found in this way, because it only looks like another albedo. That is why the family of
curves has one number, and why its contrast and its shoulder grow together (`capture.rays.response_curve`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from blender_nep.capture.rays.response_curve import MOST_STRENGTH, ResponseCurve
from blender_nep.capture.rays.tried_strengths import TriedStrengths
from blender_nep.materials.fitting import fit_groups, regions
from blender_nep.materials.palette.palette import best_of
from blender_nep.profiling import profiled
from blender_nep.shading import brdf
from blender_nep.shading.incoming_light import lobe_cones
from blender_nep.shading.light_moments import LightMoments
from blender_nep.shading.light_of_photos import LightOfPhotos
from blender_nep.shading.plenoptic import reflected
from blender_nep.tone_mapping import tone_map

if TYPE_CHECKING:
    from blender_nep.materials.samples.light_gathering import Observations
    from blender_nep.presets import MaterialPreset

_SAMPLES = 4000
"""Photo samples that are predicted"""
_DIFFUSE, _SPECULAR = 16, 8
"""Cones of the diffuse lobe, and of the specular lobe of each roughness level. With fewer cones, weak curves win, because a
stronger curve enlarges the noise."""
_REGION = 1.5
"""Width of the regions in which the material counts as one, in widths of the preset's regions: there are fewer samples"""
_BRIGHTEST = 0.7
"""Light above this share of white does not count: F_e blurs lamps and photos clip them, and both look like a curve"""
_STRENGTHS = tuple(np.linspace(0, MOST_STRENGTH, 9).tolist())
"""Strengths that are tried"""
_LEAST_WEIGHT = 0.05
"""The strength is looked for if the mean weight of the samples is at least this: the photos must show the light."""


@profiled("response curve")
def found_curve(
    seen: Observations, expected: float, preset: MaterialPreset, seed: int
) -> tuple[ResponseCurve | None, TriedStrengths | None]:
    """The response curve of the photos, and what was tried; None: there is none, or the photos tell nothing of it.

    `expected` is the strength that the photo files make likely. `seen` holds photos and F_e as they are, with the curve.
    """
    reflection = _Reflection.of(seen, preset, seed)
    if float(reflection.weight.mean()) < _LEAST_WEIGHT:
        return None, None
    middle = float(reflection.photo.clamp_min(1e-4).log().mean().exp())
    white = seen.rays.exposure
    curves = [ResponseCurve.of(strength, white, middle) for strength in _STRENGTHS]
    tried = TriedStrengths(_STRENGTHS, tuple(reflection.error_with(curve, preset) for curve in curves))
    strength = tried.best(expected, preset.response_prior)
    return (ResponseCurve.of(strength, white, middle) if strength else None), tried


@dataclass(frozen=True)
class _Reflection:
    """Photo samples [m], and what the photos show in cones around their mirrored directions."""

    photo: Tensor
    """[m, 3] the radiance of the samples in their photos"""
    shown: Tensor
    """[m, C, 3] the radiance in each cone; 0 where no photo shows it"""
    share: Tensor
    """[m, C] 0..1: how much of a cone the photos show; 0 where it meets the object"""
    lobes: Tensor
    """[m, C, 1 + R, 3] the cones' weights in the moments of the diffuse lobe and of each roughness level"""
    weight: Tensor
    """[m] how much a sample counts: less where cones meet the object, or what no photo shows, or what is bright"""
    cos_v: Tensor
    """[m]"""
    region: Tensor
    """[m] int64, the region of the surface in which the material counts as one"""

    @classmethod
    @torch.no_grad()
    def of(cls, seen: Observations, preset: MaterialPreset, seed: int) -> _Reflection:
        """Trace the cones of some of the samples."""
        generator, count = torch.Generator().manual_seed(seed), len(seen.samples)
        chosen = torch.randperm(count, generator=generator)[: min(_SAMPLES, count)].sort().values.to(seen.device)
        points, levels = seen.points[chosen], torch.tensor(preset.roughness_levels, device=seen.device)
        frame = brdf.frame(points.normal)
        v = torch.einsum("nij,ni->nj", frame, points.view)
        direction, angle, lobes = lobe_cones(v, levels, _DIFFUSE, _SPECULAR, generator)
        variance = seen.samples.reflection_variance[chosen]
        angle[:, _DIFFUSE:] = (angle[:, _DIFFUSE:] ** 2 + 4 * variance[:, None]).sqrt()
        cones = direction.shape[1]
        each = torch.arange(len(chosen), device=seen.device).repeat_interleave(cones)
        turned = torch.einsum("nij,ncj->nci", frame, direction).reshape(-1, 3)
        traced = seen.f_p.trace(points[each], turned, angle.reshape(-1))
        share = traced.coverage.clone()
        share[traced.row] = 0
        share, radiance = share.reshape(-1, cones), traced.radiance.reshape(-1, cones, 3)
        shown = torch.where(share[..., None] > 0.05, radiance / share.clamp_min(0.05)[..., None], 0)
        photo, bright = seen.samples.radiance[chosen], _BRIGHTEST * seen.rays.exposure
        sharp = lobes[:, :, 1 : 1 + len(levels) // 2, 0]
        usable = torch.einsum("nc,ncr->nr", share * (shown.amax(-1) < bright), sharp) / sharp.sum(1).clamp_min(1e-9)
        weight = usable.mean(1) ** 3 * (photo.amax(-1) < bright)
        region, _ = regions(seen.samples.position[chosen.cpu().numpy()], _REGION * preset.region)
        cos_v = (points.normal * points.view).sum(-1)
        return cls(photo, shown, share, lobes, weight, cos_v, torch.from_numpy(region).to(seen.device))

    def error_with(self, curve: ResponseCurve, preset: MaterialPreset) -> float:
        """Mean tone-mapped error of the photos of the object, if the camera had this curve."""
        light, levels = curve.light(self.shown), torch.tensor(preset.roughness_levels, device=self.photo.device)
        moments = torch.einsum("nck,nc,ncrf->nrfk", light, self.share, self.lobes)
        # Where a part of the lobe is not known, it is as bright as the rest.
        whole, known = self.lobes[..., 0].sum(1), torch.einsum("nc,ncr->nr", self.share, self.lobes[..., 0])
        moments = moments / (known / whole.clamp_min(1e-9)).clamp_min(0.05)[..., None, None]
        lit = LightMoments(moments[:, 1:], moments[:, 0, 0], known[:, 1:], self.cos_v, levels)
        groups = int(self.region.max()) + 1
        cost, albedo = fit_groups(
            lit,
            curve.light(self.photo),
            self.weight,
            self.region,
            groups,
            least_roughness=preset.least_roughness,
            clip=preset.clip,
            hypotheses=preset.metallic,
        )
        material = best_of(cost, albedo, preset.least_roughness, preset.metallic, 1.0).at(self.region)
        predicted = curve.photo(reflected(material, lit.moments(material.roughness), lit.diffuse, lit.cos_v))
        error = (tone_map(predicted) - tone_map(self.photo)).abs().mean(-1).clamp_max(preset.clip)
        return float((error * self.weight).sum() / self.weight.sum())


def with_light_itself(seen: Observations, curve: ResponseCurve) -> Observations:
    """The same observations with the light behind the photos instead of what the photos show of it."""
    f_p, samples = seen.f_p, seen.samples
    support = None if f_p.support_light is None else f_p.support_light.with_colors(curve.light)
    environment = LightOfPhotos(f_p.environment, curve)
    return replace(
        seen,
        rays=seen.rays.with_response(curve),
        samples=replace(samples, radiance=curve.light(samples.radiance)),
        f_p=replace(f_p, environment=environment, support_light=support),
    )
