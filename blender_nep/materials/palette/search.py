"""Finds the materials of an object, and the material of each sample, under the light that is known so far.

First, one material is fitted to all samples. Then candidates are fitted to small regions of the surface, and chosen as long
as a further one explains clearly more. Each sample takes the material for which its neighbors vote. Shades of one hue are
merged into one material. A material that blends of others explain as well is dropped.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from blender_nep.materials.baking import NEIGHBORS, Places, labels_at, neighbors, on_same_side, vote, weighted_mean
from blender_nep.materials.evidence.dichromatic import evidence_of_metal, places
from blender_nep.materials.evidence.diffuse_free import Evidence, evidence_of_colored, places_of_colored
from blender_nep.materials.evidence.roughness import (
    place_of_metal,
    residual_of_reflections,
    share_roughness,
    spread,
    weight_of_known_light,
)
from blender_nep.materials.fitting import fit_groups, roughness_scan
from blender_nep.materials.palette.palette import Palette, best_of, between, choose, error, place_of_least, same_material
from blender_nep.profiling import profiled, section
from blender_nep.shading.plenoptic import Material, SurfacePoints, reflected
from blender_nep.tone_mapping import tone_map

if TYPE_CHECKING:
    from blender_nep.materials.samples.photo_samples import PhotoSamples
    from blender_nep.presets import MaterialPreset
    from blender_nep.shading.incoming_light import IncomingLight

_MOST_REFITS = 4
"""Largest number of fits to the samples that show one material alone."""
_LEAST_SPREAD = 1e-6
"""Smallest spread of the log radiance. It stands for 0, where no region has enough samples."""
_SHADES = 2.5
"""Largest albedo of a dielectric until shades of one hue are merged. It is above 1, because F_e may be too dark."""


class PaletteSearch:
    """The palette, and the material of every sample. At first, one material is fitted to all samples."""

    def __init__(self, samples: PhotoSamples, light: IncomingLight, preset: MaterialPreset, device: torch.device) -> None:
        self.samples, self.light, self.preset, self.device = samples, light, preset, device
        self.target = samples.radiance
        self.label = torch.zeros(len(samples), dtype=torch.int64, device=device)
        """[n] int64: each sample's index into the palette"""
        self.weight = weight_of_known_light(light)
        """[n] how much a sample counts. Until the unseen light is found: 0.05 + the share of its light that is known"""
        self.merged = 0
        """Number of materials that the last merge has removed"""
        self._tree = cKDTree(samples.position)
        self.places = Places(samples.position, light.points.normal.cpu().numpy())
        """Where the samples are"""
        around = neighbors(self._tree, samples.position, 2 * NEIGHBORS)
        self._around = on_same_side(around, self.places, self.places)
        self._place = places(*self.places)
        self.palette = self._fit(self.label, 1)

    def fit_one(self) -> None:
        """Fit one material to all samples, under the present light."""
        self.palette = self._fit(self.label, 1)

    def metallic_swapped(self) -> Palette:
        """The palette with every metal fitted as a dielectric, and every dielectric fitted as a metal."""
        p, swapped = self.preset, self.palette
        cost, albedo = self._scan(self.label, len(self.palette))
        for i, metallic in enumerate(p.metallic):
            found = best_of(cost[i : i + 1], albedo[i : i + 1], p.least_roughness, (metallic,), 1.0)
            for k in (self.palette.metallic != metallic).nonzero().squeeze(-1).tolist():
                swapped = swapped.with_one(k, found)
        return swapped

    def metal_by_hue(self) -> Tensor:
        """What the hues of each material's samples say: from -1 (dielectric) to 1 (metal), [K].

        It is right only once the palette is: where samples of a metal are among those of a dielectric, these say metal.
        """
        return evidence_of_metal(self.light, self.target, self._place, self.label, len(self.palette))

    def grow(self, after_choice: Callable[[], None]) -> None:
        """Choose materials among candidates from small regions of the surface, and give every sample its material.

        after_choice() is called when the materials are chosen.
        """
        p = self.preset
        if p.most_materials == 1:
            return
        group, count = self._regions(self.samples.position)
        groups = len(count)
        regional = self._fit(group, groups, _SHADES)
        size = self._by_group(self.weight, group, groups)
        large = np.flatnonzero(count >= max(20, np.median(count) / 2))
        if len(large) > p.candidates:
            large = large[np.argsort(-count[large])[: p.candidates]]
        candidates = self.palette.joined(regional.pick(large.tolist()))
        cost = torch.stack([self._by_group(self._error(candidates, k), group, groups) for k in range(len(candidates))])
        chosen = choose(cost / size.clamp_min(1e-9), size, p.most_materials, p.gain)
        after_choice()
        self.palette = candidates.pick(chosen)
        self.assign()
        # A material that hardly any sample takes comes from a badly lit corner and not from the object.
        for _ in range(2):
            share = self.shares()
            keep = (share >= p.least_share).nonzero().squeeze(-1).tolist() or [int(share.argmax())]
            self.palette = self.palette.pick(keep)
            self.assign()
            self.palette = self._fit(self.label, len(self.palette), _SHADES)
            self.assign()
        self.merge_shades()
        self.drop_superfluous()

    def drop_superfluous(self) -> None:
        """Drop the materials that explain hardly more than the other materials and their blends.

        Such materials come from soft boundaries between two materials, and from gradual changes of one into another.
        """
        gain = self.preset.gain if len(self.palette) == 2 else self.preset.blended_gain
        for k in self.shares().argsort().tolist():
            if len(self.palette) == 1:
                return
            others = self.palette.pick([j for j in range(len(self.palette)) if j != k])
            with_it, without = (self._left_out(palette.with_blends()) for palette in (self.palette, others))
            if without <= (1 + gain) * with_it:
                self.palette = others
                self.assign()
                self.drop_superfluous()
                return

    def merge_shades(self, by_hue: bool = False) -> None:
        """Merge materials of one hue: a difference in brightness alone more likely comes from F_e than from the object.

        Then each material is fitted again. With `by_hue`, what its hues say counts for its class (`metal_by_hue`).
        """
        into = same_material(self.palette, self.shares(), self.preset.merge_hue, self.preset.merge_roughness)
        kept = sorted(set(into))
        if len(kept) < len(self.palette):
            self.merged = len(self.palette) - len(kept)
            self.label = torch.tensor([kept.index(k) for k in into], device=self.device)[self.label]
        p = self.preset
        cost, albedos = self._scan(self.label, len(kept))
        self.palette = self.palette.pick(kept)
        prior = 1 - p.hue_margin * self.metal_by_hue() if by_hue else 1.0
        self.palette = best_of(cost, albedos, p.least_roughness, p.metallic, (1 + p.metal_margin) * prior)
        self._find_roughness(cost, albedos)

    def blend(self) -> None:
        """Add blends of two materials, and fit the materials to the samples that show one material alone.

        A material that was fitted to blends, too, is too much like its partner. The fit is repeated as long as it lowers the
        left-out residual.
        """
        self.palette = self.palette.with_blends()
        self.assign()
        if not self.palette.blends:
            return
        left_out = self._left_out(self.palette)
        for _ in range(_MOST_REFITS):
            before = self.palette, self.label
            if not self._fit_unblended():
                return
            error = self._left_out(self.palette)
            if error >= left_out:
                self.palette, self.label = before
                return
            left_out = error

    def _fit_unblended(self) -> bool:
        """Fit each material to its unblended samples, in its class. False, and no change, if one has hardly any."""
        count = len(self.palette) - self.palette.blends
        alone = torch.where(self.label < count, self.label, -1)  # -1: in no group of the fits
        if int(torch.bincount(alone + 1, minlength=count + 1)[1:].min()) < self.preset.least_share * len(alone):
            return False
        self.palette, self.label = self.palette.pick(list(range(count))), alone
        cost, albedos = self._scan(alone, count)
        place = place_of_least(torch.stack([cost[i, :, k] for k, i in enumerate(self._classes())], 1))
        self._set(place, torch.ones_like(self.palette.metallic, dtype=torch.bool), albedos)
        self._find_roughness(cost, albedos)
        self.palette = self.palette.with_blends()
        self.assign()
        return True

    def _classes(self) -> list[int]:
        """For each material, the index of its metallic among the preset's values."""
        return [self.preset.metallic.index(metallic) for metallic in self.palette.metallic.tolist()]

    def _set(self, place: Tensor, found: Tensor, albedos: Tensor) -> None:
        """Set roughness and albedo of the materials that are `found` [K] to those at place [K] of `roughness_scan`.

        albedos [M, R, K, 3] are those of the hypotheses.
        """
        scan, k = roughness_scan(self.preset.least_roughness, self.device), len(self.palette)
        values = [between(each, place) for each in albedos]
        albedo = torch.stack([values[i][j] for j, i in enumerate(self._classes())])
        self.palette = Palette(
            torch.where(found[:, None], albedo, self.palette.albedo),
            torch.where(found, between(scan.sqrt()[:, None].expand(-1, k), place) ** 2, self.palette.roughness),
            self.palette.metallic,
        )

    def _find_roughness(self, cost: Tensor, albedos: Tensor) -> None:
        """Find the roughness of each material by what tells it (`roughness`), and its albedo with that roughness.

        cost [M, R, K] and albedos [M, R, K, 3] are those of the hypotheses for all samples of each material.
        """
        p, palette = self.preset, self.palette
        dielectric = palette.metallic < 0.5
        place, found = torch.zeros(len(palette), device=self.device), ~dielectric
        if dielectric.any():
            label = torch.where(dielectric[self.label], self.label, -1)
            residual, weight = residual_of_reflections(
                self.light, self.target, self.samples.position, label, len(palette), p
            )
            place = place_of_least(share_roughness(residual, weight, p.roughness_margin))
            found = weight > 0
            colored = self._evidence_of_colored(dielectric)
            for k, own in zip(colored, places_of_colored([*colored.values()], p.hue_residual_margin), strict=True):
                place[k], found[k] = own, True
        for metal in (~dielectric).nonzero().squeeze(-1).tolist():
            place[metal] = self._place_of_metal(metal, cost[p.metallic.index(1.0), :, metal])
            found[metal] = True
        self._set(place, found, albedos)

    def _evidence_of_colored(self, dielectric: Tensor) -> dict[int, Evidence]:
        """What the hue of their reflections tells of the dielectrics, by their indices. `dielectric` [K] says which are."""
        found = {}
        for k in dielectric.nonzero().squeeze(-1).tolist():
            own = (self.label == k).nonzero().squeeze(-1)
            region, _ = self._regions(self.samples.position[own.cpu().numpy()])
            evidence = evidence_of_colored(self.light, self.target, own, region, self.palette.albedo[k], self.preset)
            if evidence is not None:
                found[k] = evidence
        return found

    def _place_of_metal(self, k: int, residual: Tensor) -> float:
        """The place of the roughness of material k, a metal, in `roughness_scan`. residual [R] is that of its samples."""
        p, scan = self.preset, roughness_scan(self.preset.least_roughness, self.device)
        own = (self.label == k).nonzero().squeeze(-1)
        region, _ = self._regions(self.samples.position[own.cpu().numpy()])
        weight = weight_of_known_light(self.light)[own]
        photo = self.target[own].mean(-1)
        darkest = 0.1 * photo.median().clamp_min(1e-6)  # what is darker says more about noise than about the light
        of_photo = max(spread(photo + darkest, weight, region), _LEAST_SPREAD)

        def log_ratio(row: int) -> float:
            roughness = scan[row].expand(len(own))
            material = Material(self.palette.albedo[k].expand(len(own), 3), roughness, torch.ones_like(roughness))
            shown = reflected(
                material, self.light.moments(roughness, own), self.light.diffuse[own], self.light.cos_v[own]
            ).mean(-1)
            return math.log(max(spread(shown + darkest, weight, region), _LEAST_SPREAD) / of_photo)

        return place_of_metal(residual, p.spread_margin, log_ratio)

    def assign(self) -> None:
        """Give every sample the material for which its neighbors vote."""
        if len(self.palette) == 1:
            self.label.zero_()
            return
        costs = self.costs().cpu().numpy()
        with section("votes"):
            self.label = torch.from_numpy(vote(costs, *self._around)).to(self.device)

    def shares(self) -> Tensor:
        """Share [K] of the samples that have each material."""
        return torch.bincount(self.label, minlength=len(self.palette)) / len(self.label)

    @profiled("residuals")
    def costs(self, palette: Palette | None = None) -> Tensor:
        """Weighted residuals [n, K] of every sample under each material of `palette` (None: this search's palette).

        The residuals of blends are raised by `preset.blend_margin`: a blend must be clearly better than one material.
        """
        palette = self.palette if palette is None else palette
        costs = torch.stack([self._error(palette, k) for k in range(len(palette))], 1)
        return costs * torch.where(palette.blended, 1 + self.preset.blend_margin, 1.0)

    @profiled("votes")
    def smoothed(self, costs: np.ndarray, first: int = 0) -> np.ndarray:
        """Means of costs [n, K] over each sample's neighbors; near ones count more.

        The neighbors are sorted by distance and begin with number `first`; number 0 is the sample itself.
        """
        return weighted_mean(costs, *(values[:, first:] for values in self._around))

    def residual(self) -> float:
        """Mean clipped tone-mapped error of all samples under their materials, weighted by `weight`."""
        return float(self.costs().gather(1, self.label[:, None]).sum() / self.weight.sum())

    def materials_at(self, points: SurfacePoints) -> Material:
        """The material at each point: that of the nearest sample."""
        return self.palette.at(labels_at(self._tree, self.places, self.label, points))

    def shown(self) -> np.ndarray:
        """The tone-mapped radiance [n, K, 3] that each sample would have with each material."""
        return torch.stack([self._shown(k) for k in range(len(self.palette))], 1).cpu().numpy()

    def _shown(self, k: int) -> Tensor:
        material = self.palette.at(torch.full((len(self.samples),), k, device=self.device))
        return tone_map(reflected(material, self.light.moments(material.roughness), self.light.diffuse, self.light.cos_v))

    def _scan(self, group: Tensor, groups: int, most_diffuse: float = 1.0) -> tuple[Tensor, Tensor]:
        p = self.preset
        return fit_groups(
            self.light,
            self.target,
            self.weight,
            group,
            groups,
            clip=p.clip,
            least_roughness=p.least_roughness,
            hypotheses=p.metallic,
            most_diffuse=most_diffuse,
        )

    def _fit(self, group: Tensor, groups: int, most_diffuse: float = 1.0) -> Palette:
        p = self.preset
        return best_of(*self._scan(group, groups, most_diffuse), p.least_roughness, p.metallic, 1 + p.metal_margin)

    def _error(self, palette: Palette, k: int) -> Tensor:
        one = torch.tensor([k], device=self.device)
        return error(self.light, self.target, self.weight, palette.at(one), self.preset.clip)

    def _left_out(self, palette: Palette) -> float:
        """Validation error: the mean residual of the samples, each under the material for which its neighbors vote.

        The sample itself has no vote, so that a material gains nothing by fitting noise.
        """
        costs = self.costs(palette).cpu().numpy()
        label = self.smoothed(costs, first=1).argmin(1)
        return float(costs[np.arange(len(label)), label].mean())

    def _regions(self, position: np.ndarray) -> tuple[Tensor, np.ndarray]:
        """The region [n] int64 of each position [n, 3], and the number of positions in each region."""
        voxel = np.floor(position / self.preset.region).astype(np.int64)
        _, inverse, count = np.unique(voxel, axis=0, return_inverse=True, return_counts=True)
        return torch.from_numpy(inverse.ravel()).to(self.device), count

    def _by_group(self, values: Tensor, group: Tensor, groups: int) -> Tensor:
        return torch.zeros(groups, device=self.device).index_add_(0, group, values)
