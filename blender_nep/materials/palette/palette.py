"""A palette: the few materials that explain the photos.

The materials are chosen one after another from the fitted candidates (`fitting`), until a further material lowers the error
too little.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from blender_nep.materials.fitting import between, place_of_least, roughness_scan
from blender_nep.shading.light_moments import LightMoments
from blender_nep.shading.plenoptic import Material, reflected
from blender_nep.tone_mapping import tone_map

SHARES = (0.25, 0.5, 0.75)
"""Shares of the second material in a blend of two."""
_MOST_BLENDED = 4
"""Only so many materials of a palette are blended, because the number of pairs grows quickly."""


@dataclass
class Palette:
    """K materials: albedo [K, 3], roughness [K], metallic [K]. The last `blends` materials are mixtures of two others."""

    albedo: Tensor
    roughness: Tensor
    metallic: Tensor
    blends: int = 0

    @property
    def blended(self) -> Tensor:
        """[K] bool: which materials are mixtures."""
        return torch.arange(len(self), device=self.roughness.device) >= len(self) - self.blends

    def pairs(self) -> list[tuple[int, int]]:
        """The materials (i, j) that are blended, in the order of the blends. Each pair has one blend for each of SHARES."""
        return [(i, j) for j in range(min(len(self) - self.blends, _MOST_BLENDED)) for i in range(j)]

    def with_blends(self) -> Palette:
        """This palette, followed by mixtures of every two of its first `_MOST_BLENDED` materials.

        Pixels at soft boundaries between two materials need the mixtures.
        """
        pairs = self.pairs()
        if not pairs:
            return self
        i, j = torch.tensor(pairs, device=self.roughness.device).T.repeat_interleave(len(SHARES), 1)
        t = torch.tensor(SHARES, device=self.roughness.device).repeat(len(pairs))

        def extended(values: Tensor) -> Tensor:
            share = t.reshape(-1, *[1] * (values.ndim - 1))
            return torch.cat([values, torch.lerp(values[i], values[j], share)])

        return Palette(extended(self.albedo), extended(self.roughness), extended(self.metallic), len(t))

    def __len__(self) -> int:
        return len(self.roughness)

    def at(self, index: Tensor) -> Material:
        """The materials with the indices [n]."""
        return Material(self.albedo[index], self.roughness[index], self.metallic[index])

    def with_one(self, k: int, other: Palette) -> Palette:
        """This palette, with material k replaced by material k of another palette."""

        def swap(own: Tensor, its: Tensor) -> Tensor:
            return torch.cat([own[:k], its[k : k + 1], own[k + 1 :]])

        return Palette(
            swap(self.albedo, other.albedo), swap(self.roughness, other.roughness), swap(self.metallic, other.metallic)
        )

    def joined(self, other: Palette) -> Palette:
        """This palette, followed by another palette's materials."""
        return Palette(
            torch.cat([self.albedo, other.albedo]),
            torch.cat([self.roughness, other.roughness]),
            torch.cat([self.metallic, other.metallic]),
        )

    def pick(self, index: list[int]) -> Palette:
        i = torch.tensor(index, dtype=torch.int64, device=self.roughness.device)
        return Palette(self.albedo[i], self.roughness[i], self.metallic[i])


def error(light: LightMoments, target: Tensor, weight: Tensor, material: Material, clip: float) -> Tensor:
    """Residual [n] of every sample under its material, in 0..`clip`, multiplied by `weight` [n].

    It is the mean absolute tone-mapped difference from target [n, 3]. `material` holds n materials, or one for all.
    """
    roughness = material.roughness[0] if len(material.roughness) == 1 else material.roughness
    predicted = reflected(material, light.moments(roughness), light.diffuse, light.cos_v)
    return (tone_map(predicted) - tone_map(target)).abs().mean(-1).clamp_max(clip) * weight


def best_of(
    cost: Tensor, albedo: Tensor, least_roughness: float, hypotheses: tuple[float, ...], metal_factor: float
) -> Palette:
    """The best hypothesis of each group, from cost [M, R, groups] and albedo [M, R, groups, 3] of `fit_groups`.

    The residual of a metal is multiplied by metal_factor.
    """
    prior = 1 + torch.tensor(hypotheses, device=cost.device)[:, None] * (metal_factor - 1)
    return of_classes((cost.amin(1) * prior).argmin(0), cost, albedo, least_roughness, hypotheses)


def of_classes(i: Tensor, cost: Tensor, albedo: Tensor, least_roughness: float, hypotheses: tuple[float, ...]) -> Palette:
    """The best hypothesis of each group among those with its metallic value, whose index is i [groups].

    The roughness is refined to a fraction of a step (`place_of_least`).
    """
    scan = roughness_scan(least_roughness, cost.device)
    each = torch.arange(cost.shape[2], device=cost.device)
    place = place_of_least(cost[i, :, each].T)
    return Palette(
        between(albedo[i, :, each].transpose(0, 1), place),
        between(scan.sqrt()[:, None].expand(-1, len(each)), place) ** 2,
        torch.tensor(hypotheses, device=cost.device)[i],
    )


def choose(cost: Tensor, size: Tensor, most: int, gain: float) -> list[int]:
    """Choose at most `most` materials greedily; returns the indices of the chosen candidates.

    cost [C, groups] is the mean residual of each group under each candidate; size [groups] is the weight of a group. The
    first material is the best for all groups together. Each further material must lower the total by the share `gain`.
    """
    weighted = cost * size
    chosen = [int(weighted.sum(1).argmin())]
    current = weighted[chosen[0]]
    while len(chosen) < most:
        totals = torch.minimum(weighted, current).sum(1)
        best = int(totals.argmin())
        if totals[best] > (1 - gain) * current.sum():
            break
        chosen.append(best)
        current = torch.minimum(weighted[best], current)
    return chosen


def same_material(palette: Palette, share: Tensor, hue: float, roughness: float) -> list[int]:
    """For each material k, the index of the larger material of which k is a shade, or k itself. share [K]: of the samples.

    Two materials are shades of one material if both are metals or both are dielectrics, and if their chromaticities (albedo
    divided by its sum) differ by less than `hue`. Metals must also differ by less than `roughness` in roughness, because
    reflections show a metal's roughness. The brightness of a dielectric comes mostly from irradiance, and F_e is least
    certain about light from directions that no photo shows.
    """
    chroma = palette.albedo / palette.albedo.sum(1, keepdim=True).clamp_min(1e-6)
    into = list(range(len(palette)))
    for k in share.argsort(descending=True).tolist():
        if into[k] != k:
            continue
        near = (chroma - chroma[k]).norm(dim=1) < hue
        near &= palette.metallic == palette.metallic[k]
        near &= (palette.metallic < 0.5) | ((palette.roughness - palette.roughness[k]).abs() < roughness)
        for j in near.nonzero().squeeze(-1).tolist():
            if into[j] == j and share[j] <= share[k]:
                into[j] = k
    return into
