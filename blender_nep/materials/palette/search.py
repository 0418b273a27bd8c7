"""Finds the materials of an object, and the material of each sample, under the light that is known so far.

First, one material is fitted to all samples. Then candidates are fitted to small regions of the surface, and chosen as long
as a further one explains clearly more. Each sample takes the material for which its neighbors vote. Shades of one hue are
merged into one material. A material that blends of others explain as well is dropped.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from blender_nep.materials.baking import NEIGHBORS, Places, labels_at, neighbors, on_same_side, weighted_mean
from blender_nep.materials.evidence.decision import Account, decide_metallic, decide_roughness
from blender_nep.materials.evidence.hue import Hue, evidence_of_metal, places
from blender_nep.materials.evidence.protocol import FittedMaterials
from blender_nep.materials.evidence.regions import Regions, class_by_regions
from blender_nep.materials.fitting import (
    between,
    fit_groups,
    place_of_least,
    regions,
    roughness_scan,
    weight_of_known_light,
)
from blender_nep.materials.metal_brightness import cost_of_darkness
from blender_nep.materials.palette.palette import Palette, best_of, choose, error, of_classes, same_material
from blender_nep.materials.palette.places_of_metal import PlacesOfMetal, advantage_of_metal, not_there
from blender_nep.materials.place_colors import median_color
from blender_nep.profiling import profiled, section
from blender_nep.shading.plenoptic import Material, SurfacePoints, reflected
from blender_nep.tone_mapping import tone_map

if TYPE_CHECKING:
    from blender_nep.materials.samples.photo_samples import PhotoSamples
    from blender_nep.presets import MaterialPreset
    from blender_nep.shading.incoming_light import IncomingLight

_MOST_REFITS = 4
"""Largest number of fits to the samples that show one material alone."""
_LEAST_SURE = 0.1
"""A material is fitted to its sure samples alone if they are this share of its samples."""
_OTHERS = 8
"""Samples of other photos around a sample whose material it gets."""
_SHADES = 2.5
"""Largest albedo of a dielectric until shades of one hue are merged. It is above 1, because F_e may be too dark."""


@dataclass(frozen=True, eq=False)
class FoundPalette:
    """The result of a palette search: the palette, and the material of every sample."""

    palette: Palette
    label: Tensor
    """[n] int64: each sample's index into the palette"""
    merged: int = 0
    """Number of materials that the last merge has removed"""
    account: Account = field(default_factory=Account)
    """What told the class and the roughness of the materials. It is empty as long as they were fitted alone"""
    metal: np.ndarray | None = None
    """[n] bool: which samples lie where the surface is metal, up to edges of color. None: each place decides alone"""
    doubtful: Tensor | None = None
    """[n] bool: samples that a material of the other class explains better. They tell nothing of the materials, because
    their light is not known well. None: there are none"""

    @property
    def label_of_fits(self) -> Tensor:
        """[n] int64: `label`, or -1 for samples that no fit uses. No material loses nearly all of its samples."""
        if self.doubtful is None:
            return self.label
        sure = torch.bincount(self.label[~self.doubtful], minlength=len(self.palette))
        enough = sure >= _LEAST_SURE * torch.bincount(self.label, minlength=len(self.palette))
        return torch.where(self.doubtful & enough[self.label], -1, self.label)

    def shares(self) -> Tensor:
        """Share [K] of the samples that have each material."""
        return torch.bincount(self.label, minlength=len(self.palette)) / len(self.label)


@dataclass(frozen=True, eq=False)
class PaletteSearch:
    """Photo samples in the light that is known so far. Its methods take and return palettes, and change nothing."""

    samples: PhotoSamples
    light: IncomingLight
    preset: MaterialPreset
    device: torch.device
    weight: Tensor
    """[n] how much a sample counts. Until the unseen light is found: 0.05 + the share of its light that is known"""
    places: Places
    """Where the samples are"""
    metals: PlacesOfMetal
    """Decides where the surface is metal"""
    _tree: cKDTree
    _around: tuple[np.ndarray, np.ndarray]
    """Distances and indices of the neighbors of each sample"""
    _place: np.ndarray
    """[n] the place of each sample, as `evidence.hue` has it"""

    @classmethod
    def of(cls, samples: PhotoSamples, light: IncomingLight, preset: MaterialPreset, device: torch.device) -> PaletteSearch:
        """The samples, and their neighbors on the surface."""
        tree = cKDTree(samples.position)
        where = Places(samples.position, light.points.normal.cpu().numpy())
        found = neighbors(tree, samples.position, 2 * NEIGHBORS)
        color = median_color(tree, samples.radiance.cpu().numpy(), samples.position, 2 * NEIGHBORS)
        metals = PlacesOfMetal.of(where, tree, color, found[1])
        around = on_same_side(found, where, where)
        return cls(samples, light, preset, device, weight_of_known_light(light), where, metals, tree, around, places(*where))

    def under(self, light: IncomingLight) -> PaletteSearch:
        """The same samples in another light."""
        return replace(self, light=light)

    def evenly_weighted(self) -> PaletteSearch:
        """The same samples, all of which count alike."""
        return replace(self, weight=torch.ones_like(self.weight))

    @property
    def target(self) -> Tensor:
        """[n, 3] linear radiance of the samples."""
        return self.samples.radiance

    def one(self) -> FoundPalette:
        """One material, fitted to all samples."""
        label = torch.zeros(len(self.samples), dtype=torch.int64, device=self.device)
        return FoundPalette(self._fit(label, 1), label)

    def metallic_swapped(self, found: FoundPalette) -> Palette:
        """The palette with every metal fitted as a dielectric, and every dielectric fitted as a metal."""
        p, swapped = self.preset, found.palette
        cost, albedo = self._scan(found.label_of_fits, len(found.palette))
        for i, metallic in enumerate(p.metallic):
            fitted = best_of(cost[i : i + 1], albedo[i : i + 1], p.least_roughness, (metallic,), 1.0)
            for k in (found.palette.metallic != metallic).nonzero().squeeze(-1).tolist():
                swapped = swapped.with_one(k, fitted)
        return swapped

    def class_said(self, found: FoundPalette) -> Tensor:
        """What regions say of each material's class, or else the hues of its samples: -1 (dielectric) to 1 (metal), [K].

        Hues are right only once the palette is: where samples of a metal are among those of a dielectric, these say metal.
        0 where neither says anything.
        """
        count, label = len(found.palette), found.label_of_fits
        said = torch.zeros_like(found.palette.metallic)
        if Hue.name not in self.preset.without:
            said = evidence_of_metal(self.light, self.target, self._place, label, count)
        if count == 1 or len(self.preset.metallic) == 1 or Regions.name in self.preset.without:
            return said
        samples = self.samples
        clear = class_by_regions(self.light, self.target, samples.position, samples.photo, label, count, self.preset)
        return torch.where(clear != 0, clear, said)

    def grown(self, found: FoundPalette, after_choice: Callable[[], None]) -> FoundPalette:
        """Choose materials among those found and candidates from small regions of the surface, and assign the samples.

        after_choice() is called when the materials are chosen.
        """
        p = self.preset
        if p.most_materials == 1:
            return found
        region, count = regions(self.samples.position, p.region)
        group, groups = torch.from_numpy(region).to(self.device), len(count)
        regional = self._fit(group, groups, _SHADES)
        size = self._by_group(self.weight, group, groups)
        large = np.flatnonzero(count >= max(20, np.median(count) / 2))
        if len(large) > p.candidates:
            large = large[np.argsort(-count[large])[: p.candidates]]
        candidates = found.palette.joined(regional.pick(large.tolist()))
        cost = torch.stack([self._by_group(self._error(candidates, k), group, groups) for k in range(len(candidates))])
        chosen = choose(cost / size.clamp_min(1e-9), size, p.most_materials, p.gain)
        after_choice()
        found = self.assigned(found, candidates.pick(chosen))
        # A material that hardly any sample takes comes from a badly lit corner and not from the object.
        for _ in range(2):
            share = found.shares()
            keep = (share >= p.least_share).nonzero().squeeze(-1).tolist() or [int(share.argmax())]
            found = self.assigned(found, found.palette.pick(keep))
            found = self.assigned(found, self._fit(found.label_of_fits, len(found.palette), _SHADES))
        return self.without_superfluous(self.with_shades_merged(found))

    def of_regions(self) -> tuple[Tensor, Tensor]:
        """The small region [n] int64 of each sample, and its radiance [n, 3] with the material that fits best there."""
        region, count = regions(self.samples.position, self.preset.region)
        group = torch.from_numpy(region).to(self.device)
        material = self._fit(group, len(count), _SHADES).at(group)
        return group, reflected(material, self.light.moments(material.roughness), self.light.diffuse, self.light.cos_v)

    def without_superfluous(self, found: FoundPalette) -> FoundPalette:
        """Without the materials that explain hardly more than the other materials and their blends.

        Such materials come from soft boundaries between two materials, and from gradual changes of one into another.
        """
        count = len(found.palette)
        if count == 1:
            return found
        gain = self.preset.gain if count == 2 else self.preset.blended_gain
        for k in found.shares().argsort().tolist():
            kept = [j for j in range(count) if j != k]
            others = found.palette.pick(kept)
            with_it, without = (self._left_out(palette.with_blends()) for palette in (found.palette, others))
            if without <= (1 + gain) * with_it:
                fewer = replace(found, account=found.account.pick(kept))
                return self.without_superfluous(self.assigned(fewer, others))
        return found

    def with_shades_merged(self, found: FoundPalette, by_hue: bool = False) -> FoundPalette:
        """Merge materials of one hue: a difference in brightness alone more likely comes from F_e than from the object.

        Then each material is fitted again. With `by_hue`, what its hues say counts for its class (`evidence.hue`).
        """
        p = self.preset
        into = same_material(found.palette, found.shares(), p.merge_hue, p.merge_roughness)
        kept = sorted(set(into))
        if len(kept) < len(found.palette):
            label = torch.tensor([kept.index(k) for k in into], device=self.device)[found.label]
            found = FoundPalette(found.palette.pick(kept), label, len(found.palette) - len(kept))
        cost, albedos = self._scan(found.label_of_fits, len(kept))
        without = () if by_hue else (Hue.name, Regions.name)
        chosen, account = decide_metallic(self._fitted(found, cost), without, self._plausible(cost, albedos))
        palette = of_classes(chosen, cost, albedos, p.least_roughness, p.metallic)
        return self._decided(replace(found, palette=palette, account=account), cost, albedos)

    def _plausible(self, cost: Tensor, albedos: Tensor) -> Tensor:
        """Factors [M, K] of the classes' costs: metals that are too dark to be metals cost more.

        cost [M, R, K] and albedos [M, R, K, 3] are those of the hypotheses.
        """
        each = torch.arange(cost.shape[2], device=cost.device)
        best = [own[at.argmin(0), each] for own, at in zip(albedos, cost, strict=True)]
        classes = [torch.full_like(cost[0, 0], metallic) for metallic in self.preset.metallic]
        return torch.stack([cost_of_darkness(*both) for both in zip(best, classes, strict=True)])

    def blended(self, found: FoundPalette) -> FoundPalette:
        """Add blends of two materials, and fit the materials to the samples that show one material alone.

        A material that was fitted to blends, too, is too much like its partner. The fit is repeated as long as it lowers the
        left-out residual.
        """
        found = self.assigned(found, found.palette.with_blends())
        if not found.palette.blends:
            return found
        left_out = self._left_out(found.palette)
        for _ in range(_MOST_REFITS):
            refitted = self._fitted_unblended(found)
            if refitted is None:
                return found
            error = self._left_out(refitted.palette)
            if error >= left_out:
                return found
            found, left_out = refitted, error
        return found

    def _fitted_unblended(self, found: FoundPalette) -> FoundPalette | None:
        """Each material fitted to its unblended samples, in its class, with blends. None if one has hardly any."""
        count = len(found.palette) - found.palette.blends
        alone = torch.where(found.label < count, found.label_of_fits, -1)  # -1: in no group of the fits
        if int(torch.bincount(alone + 1, minlength=count + 1)[1:].min()) < self.preset.least_share * len(alone):
            return None
        palette = found.palette.pick(list(range(count)))
        cost, albedos = self._scan(alone, count)
        place = place_of_least(torch.stack([cost[i, :, k] for k, i in enumerate(self._classes(palette))], 1))
        palette = self._at(palette, place, torch.ones_like(palette.metallic, dtype=torch.bool), albedos)
        own = self._decided(replace(found, palette=palette, label=alone, doubtful=None), cost, albedos)
        return self.assigned(own, own.palette.with_blends())

    def _classes(self, palette: Palette) -> list[int]:
        """For each material, the index of its metallic among the preset's values."""
        return [self.preset.metallic.index(metallic) for metallic in palette.metallic.tolist()]

    def _at(self, palette: Palette, place: Tensor, known: Tensor, albedos: Tensor) -> Palette:
        """The materials whose place [K] of `roughness_scan` is `known` [K], with the roughness and the albedo there.

        albedos [M, R, K, 3] are those of the hypotheses. The other materials stay as they are.
        """
        scan, k = roughness_scan(self.preset.least_roughness, self.device), len(palette)
        values = [between(each, place) for each in albedos]
        albedo = torch.stack([values[i][j] for j, i in enumerate(self._classes(palette))])
        return Palette(
            torch.where(known[:, None], albedo, palette.albedo),
            torch.where(known, between(scan.sqrt()[:, None].expand(-1, k), place) ** 2, palette.roughness),
            palette.metallic,
        )

    def _decided(self, found: FoundPalette, cost: Tensor, albedos: Tensor) -> FoundPalette:
        """The roughness of each material by what tells it (`evidence`), and its albedo with that roughness.

        cost [M, R, K] and albedos [M, R, K, 3] are those of the hypotheses for all samples of each material.
        """
        place, known, account = decide_roughness(self._fitted(found, cost))
        palette = self._at(found.palette, place, known, albedos)
        return replace(found, palette=palette, account=found.account.and_then(account))

    def _fitted(self, found: FoundPalette, cost: Tensor) -> FittedMaterials:
        """What is known of the materials, for the evidence. cost [M, R, K] is that of the hypotheses."""
        light, position, palette = self.light, self.samples.position, found.palette
        return FittedMaterials(
            light,
            self.target,
            position,
            self._place,
            found.label_of_fits,
            palette.albedo,
            palette.metallic,
            cost,
            self.preset,
            self.samples.photo,
        )

    def assigned(self, found: FoundPalette, palette: Palette) -> FoundPalette:
        """What was found, with another palette. Every sample gets the material for which its neighbors vote."""
        if len(palette) == 1:
            return replace(found, palette=palette, label=torch.zeros_like(found.label), metal=None, doubtful=None)
        costs = self.costs(palette).cpu().numpy()
        metal = self._places_of_metal(palette, costs, self.preset.unclear_classes)
        with section("votes"):
            votes = self.smoothed(costs)
            label, doubtful = votes.argmin(1), None
            if metal is not None:
                doubtful = torch.from_numpy((palette.metallic.cpu().numpy()[label] > 0.5) != metal).to(self.device)
                excluded = not_there(palette.metallic.cpu().numpy(), metal, self.metals.at_boundaries(metal))
                label = np.where(excluded, np.inf, votes).argmin(1)
        own = torch.from_numpy(label).to(self.device)
        return replace(found, palette=palette, label=own, metal=metal, doubtful=doubtful)

    def labels_by_others(self, found: FoundPalette, held_out: Tensor) -> Tensor:
        """The label [n] of each sample, but those of held_out [n] bool have that of the others around them."""
        costs, held = self.costs(found.palette).cpu().numpy(), held_out.cpu().numpy()
        at, others = (Places(self.places.position[rows], self.places.normal[rows]) for rows in (held, ~held))
        _, near = on_same_side(neighbors(cKDTree(others.position), at.position, _OTHERS), at, others)
        votes, excluded = costs[~held][near].mean(1), self.excluded(found, at)
        own = (votes if excluded is None else np.where(excluded, np.inf, votes)).argmin(1)
        return found.label.index_put((held_out,), torch.from_numpy(own).to(self.device))

    def metal_by_colors(self, palette: Palette) -> np.ndarray | None:
        """Which samples [n] bool lie on metal, up to edges of color.

        None if the palette has one class alone, or if each place decides alone (`preset.unclear_classes`).
        """
        if math.isinf(self.preset.unclear_classes):
            return None
        return self._places_of_metal(palette, self.costs(palette).cpu().numpy(), unclear=0.0)

    def _places_of_metal(self, palette: Palette, costs: np.ndarray, unclear: float) -> np.ndarray | None:
        """Which samples [n] bool lie on metal, by costs [n, K]. None with one class, or if the photos tell both apart."""
        alone = len(palette) - palette.blends
        metallic = palette.metallic[:alone].cpu().numpy()
        advantage = advantage_of_metal(costs[:, :alone], metallic, unclear)
        return None if advantage is None else self.metals.decide(advantage, self.preset.smooth_classes)

    def excluded(self, found: FoundPalette, at: Places) -> np.ndarray | None:
        """Which materials of the palette m places cannot have [m, K] bool, by the samples around them. None: all can be."""
        if found.metal is None:
            return None
        return not_there(found.palette.metallic.cpu().numpy(), *self.metals.around(found.metal, at))

    def metal_at(self, metal: np.ndarray, at: Places) -> np.ndarray:
        """Whether m places are metal [m] bool, if `metal` [n] bool says it of the samples."""
        return self.metals.around(metal, at)[0]

    @profiled("residuals")
    def costs(self, palette: Palette) -> Tensor:
        """Weighted residuals [n, K] of every sample under each material of a palette.

        The residuals of blends are raised by `preset.blend_margin`: a blend must be clearly better than one material.
        """
        costs = torch.stack([self._error(palette, k) for k in range(len(palette))], 1)
        return costs * torch.where(palette.blended, 1 + self.preset.blend_margin, 1.0)

    @profiled("votes")
    def smoothed(self, costs: np.ndarray, first: int = 0) -> np.ndarray:
        """Means of costs [n, K] over each sample's neighbors; near ones count more.

        The neighbors are sorted by distance and begin with number `first`; number 0 is the sample itself.
        """
        return weighted_mean(costs, *(values[:, first:] for values in self._around))

    def residual(self, found: FoundPalette) -> float:
        """Mean clipped tone-mapped error of all samples under their materials, weighted by `weight`."""
        return float(self.costs(found.palette).gather(1, found.label[:, None]).sum() / self.weight.sum())

    def materials_at(self, found: FoundPalette) -> Callable[[SurfacePoints], Material]:
        """A function that gives the material at each point: that of the nearest sample."""
        return lambda points: found.palette.at(labels_at(self._tree, self.places, found.label, points))

    def shown(self, palette: Palette) -> np.ndarray:
        """The tone-mapped radiance [n, K, 3] that each sample would have with each material."""
        return torch.stack([self._shown(palette, k) for k in range(len(palette))], 1).cpu().numpy()

    def _shown(self, palette: Palette, k: int) -> Tensor:
        material = palette.at(torch.full((len(self.samples),), k, device=self.device))
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

    def _by_group(self, values: Tensor, group: Tensor, groups: int) -> Tensor:
        return torch.zeros(groups, device=self.device).index_add_(0, group, values)
