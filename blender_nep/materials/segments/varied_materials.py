"""Materials that vary from place to place, for objects that a palette of few materials does not explain.

Each segment of the surface (`segments`) gets a material of its own. Few samples tell little about a roughness, so the
residuals of near segments of similar color are averaged before metallic and roughness are chosen. The albedo is then found
for every pixel from its neighbors.

More freedom always explains photos better, and errors of the light would become paint. So these materials are used only if
they explain photos that they were not fitted to much better than the palette does.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from blender_nep.materials.baking import LabeledPoints, Places, kernel, neighbors, on_same_side
from blender_nep.materials.evidence.decision import decide_segments
from blender_nep.materials.evidence.residual import NEAR_SEGMENTS, SegmentResidual
from blender_nep.materials.fitting import (
    between,
    fit_groups,
    place_in_scan,
    place_of_least,
    roughness_scan,
    weight_of_found_light,
)
from blender_nep.materials.labels.pixel_votes import Surfels, nearest_samples
from blender_nep.materials.palette.palette import Palette, error
from blender_nep.materials.place_colors import median_color
from blender_nep.materials.segments.segments import Segments, features
from blender_nep.ops.materials.local_albedo import fit_local_albedos
from blender_nep.profiling import profiled
from blender_nep.shading.plenoptic import Material, affine_in_albedo

if TYPE_CHECKING:
    from blender_nep.materials.palette.search import FoundPalette, PaletteSearch
    from blender_nep.materials.samples.light_gathering import LitSamples
    from blender_nep.materials.samples.photo_samples import PhotoSamples
    from blender_nep.presets import MaterialPreset
    from blender_nep.shading.light_moments import LightMoments

_SAMPLES_OF_SEGMENT = 50
"""Mean number of samples in a segment."""
_FEW_PIXELS = 8
"""Samples around a sample whose median is its color. Samples lie far apart, so more would be of other paint."""
_MANY_PIXELS = 12
"""Label pixels around a point whose median is its color. More would give thin outlines the color of their surroundings."""
_BLEND_SEGMENTS, _BLEND_REACH = 8, 1.5
"""Number of the near segments that share their roughness between their centers, and the distance at which their weight falls
to 1/e."""
_VOTERS, _VOTE_REACH = 33, 3.0
"""Number of the label pixels nearest to a label pixel, itself among them, whose majority is its class, and the largest
distance of the farthest one, in pixels of a photo. Farther ones would outvote thin outlines."""
_HELD_OUT = 4
"""One photo of this many is held out while the gain is measured."""
_UNSEEN_GAINS = (0.6, 0.75, 0.9, 1.05, 1.2)
"""Factors of the unseen light that are tried."""
_ALBEDO_PIXELS = 8
"""Label pixels around a label pixel, itself among them, that share one albedo. More would blur thin outlines."""
_BLOCK = 1 << 16
"""Points that vote at a time. This bounds the memory."""
_ITERATIONS = 6
"""Iterations of the reweighted least squares of a pixel's albedo."""


@dataclass
class VariedMaterials:
    """The materials of K segments, and where the segments are."""

    segments: Segments
    palette: Palette
    """The material of each segment"""
    shift: float = 0.0
    """By how much the dielectrics are moved from where their residual is least (`fit_segments`)"""
    exact: np.ndarray | None = None
    """[K] bool: segments whose roughness an artist has set, so that it is not interpolated. None: no segment"""
    learned: Palette | None = None
    """The palette before an artist's corrections. None: there are none"""

    @profiled("varied materials")
    def at(self, places: cKDTree, color: np.ndarray, width: float) -> Material:
        """The materials of m points at `places` [m, 3] with median log color [m, 3]; width: that of a pixel on the surface.

        Each point belongs to a segment, which gives it albedo and metallic. This is the nearest segment of the class that
        the majority of the points around has. Where the points lie far apart, it is the nearest of all segments. The
        roughness is interpolated between near segments of the same class. Where an artist has corrected neither class nor
        roughness of the own segment, the neighbors count as they were learned.
        """
        distance, index = self.segments.near(features(places.data, color), _BLEND_SEGMENTS)
        learned = self.palette if self.learned is None else self.learned
        metal = learned.metallic.cpu().numpy() > 0.5
        voted = majority(places, metal[index[:, 0]], _VOTE_REACH * width)
        place = (metal[index] == voted[:, None]).argmax(1)  # 0, the nearest, if no near segment has this class
        own = np.take_along_axis(index, place[:, None], 1)
        weight = np.exp(-((distance / _BLEND_REACH) ** 2)) + 1e-9
        roughness = _interpolated_roughness(learned, index, own, weight)
        own = own[:, 0]
        if self.learned is not None:
            other = (self.palette.metallic != learned.metallic).cpu().numpy()[own]
            roughness = np.where(other, _interpolated_roughness(self.palette, index, own[:, None], weight), roughness)
        if self.exact is not None:
            roughness = np.where(self.exact[own], self.palette.roughness.cpu().numpy()[own], roughness)
        found = self.palette.at(torch.from_numpy(own).to(self.palette.roughness.device))
        return Material(found.albedo.clamp(0, 1), torch.from_numpy(roughness).to(found.roughness), found.metallic)


def _interpolated_roughness(palette: Palette, index: np.ndarray, own: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Means [m] of the roughness of segments index [m, S] with the class of segment own [m, 1], with weight [m, S]."""
    metallic, root = palette.metallic.cpu().numpy(), palette.roughness.sqrt().cpu().numpy()
    weight = weight * (metallic[index] == metallic[own])
    return ((root[index] * weight).sum(1) / weight.sum(1)) ** 2


def majority(places: cKDTree, yes: np.ndarray, reach: float) -> np.ndarray:
    """The values yes [m] bool of m points at `places`, each replaced by that of most of its _VOTERS nearest points.

    A point is one of its own nearest points. It keeps its value if they do not all lie within `reach`.
    """
    out = yes.copy()
    for start in range(0, len(yes), _BLOCK):
        part = slice(start, start + _BLOCK)
        distance, index = neighbors(places, places.data[part], _VOTERS)
        near = distance[:, -1] <= reach
        out[part][near] = yes[index[near]].mean(1) > 0.5
    return out


def segments_of(samples: PhotoSamples, seed: int, pixels: PhotoSamples | None = None) -> Segments:
    """The segments of the photo samples.

    The label pixels `pixels` lie closer together than the samples. With them, thin outlines have their own color.
    """
    shown, count = (samples, _FEW_PIXELS) if pixels is None else (pixels, _MANY_PIXELS)
    color = median_color(cKDTree(shown.position), shown.radiance.cpu().numpy(), samples.position, count)
    return Segments.of(samples.position, color, max(1, len(samples) // _SAMPLES_OF_SEGMENT), seed)


def classes_of_segments(metal: np.ndarray, segments: Segments) -> Tensor:
    """The metallic value [K] of each segment: that of most of its n samples, of which `metal` [n] bool are metal."""
    count = np.bincount(segments.label, minlength=len(segments))
    share = np.bincount(segments.label, metal, len(segments)) / np.maximum(count, 1)
    return torch.from_numpy((share > 0.5).astype(np.float32))


def gain_of_segments(
    search: PaletteSearch,
    found: FoundPalette,
    segments: Segments,
    classes: Tensor | None = None,
    palette_sees_all: bool = True,
) -> float:
    """Share by which the materials of segments lower the residual of the palette `found`, on photos that were held out.

    classes [K] are the metallic values of the segments. None: the photos decide. If the palette sees all photos, each
    sample has the material that suits it and its neighbors best, blends among them. Then the gain is rather too small than
    too large. Else samples of the held-out photos have the material of their neighbors in other photos. 0 if there are too
    few photos.
    """
    light, p = search.light, search.preset
    label = torch.from_numpy(segments.label).to(search.device)
    held_out = search.samples.photo % _HELD_OUT == 0
    if not bool(held_out.any()) or bool(held_out.all()):
        return 0.0
    trained = fit_segments(light, search.target, torch.where(held_out, -1, label), segments, p, classes)
    own = found.label if palette_sees_all else search.labels_by_others(found, held_out)
    even = torch.ones_like(search.weight)
    of_segments = error(light, search.target, even, trained.at(label), p.clip)[held_out].mean()
    of_palette = error(light, search.target, even, found.palette.at(own), p.clip)[held_out].mean()
    return float(1 - of_segments / of_palette.clamp_min(1e-9))


@profiled("varied materials")
def fit_segments(
    light: LightMoments,
    target: Tensor,
    label: Tensor,
    segments: Segments,
    preset: MaterialPreset,
    metallic: Tensor | None = None,
    roughness: Tensor | None = None,
    shift: float = 0.0,
) -> Palette:
    """The material of each of K segments. label [n] int64 is that of the samples, -1 for those that do not count.

    metallic [K] are the classes, if they are known. Else the photos decide between those of the preset. roughness [K] are
    values that are given; NaN, and None for all of them, where the photos decide. shift: what the evidence moves the
    dielectrics by (`evidence.decision.shift_of_dielectrics`).

    The residuals of near segments decide (`SegmentResidual`). Segments whose samples do not count get the roughness and the
    class of their neighbors, and no sensible albedo.
    """
    p, count = preset, len(segments)
    classes = p.metallic if metallic is None else (0.0, 1.0)
    weight = weight_of_found_light(light)
    residual, albedo = fit_groups(
        light,
        target,
        weight,
        label,
        count,
        least_roughness=p.least_roughness,
        clip=p.clip,
        hypotheses=classes,
    )
    mass = torch.bincount(label.clamp_min(0), weight * (label >= 0), minlength=count).cpu().numpy()
    scan, cost = roughness_scan(p.least_roughness, light.cos_v.device), residual.cpu().numpy()
    near = segments.near(segments.center, NEAR_SEGMENTS)
    known = None if metallic is None else (metallic > 0.5).long().cpu().numpy()
    chosen, place = decide_segments(SegmentResidual(cost, mass, *near), p, classes, known, shift)
    each, place = np.arange(count), place.to(residual)
    found = between(scan.sqrt()[:, None].expand(-1, count), place) ** 2
    if roughness is not None:
        place = torch.where(roughness.isnan(), place, place_in_scan(roughness, p.least_roughness))
        found = torch.where(roughness.isnan(), found, roughness)
    return Palette(
        between(albedo[torch.from_numpy(chosen), :, torch.from_numpy(each)].transpose(0, 1), place),
        found,
        torch.tensor(classes, device=residual.device)[torch.from_numpy(chosen)],
    )


@profiled("varied materials")
def gain_of_unseen_light(
    lit: LitSamples, label: Tensor, segments: Segments, preset: MaterialPreset, classes: Tensor | None = None
) -> float:
    """The factor of the unseen light with which the segments explain the photos best. label [n] int64: their segments.

    The unseen light was found with few materials, so it takes part in what they explain badly. The brightness of paint that
    it lights from one side and not from the other tells its strength. The classes are those without a factor, or the values
    of metallic `classes` [K]. It is 1 if the photos show no light, for then there is nothing to compare the unseen light
    with.
    """
    if not lit.light.in_photos:
        return 1.0
    target, even = lit.samples.radiance, torch.ones(len(lit.samples), device=label.device)
    metallic = fit_segments(lit.light, target, label, segments, preset, classes).metallic
    residual = []
    for gain in _UNSEEN_GAINS:
        light = lit.with_unseen(gain).light
        found = fit_segments(light, target, label, segments, preset, metallic)
        residual.append(error(light, target, even, found.at(label), preset.clip).mean())
    place = float(place_of_least(torch.stack(residual)[:, None]))
    return float(np.interp(place, np.arange(len(_UNSEEN_GAINS)), _UNSEEN_GAINS))


@dataclass
class PlacedPixels:
    """m pixels of the photos, the surface points that they show, and the samples whose light is taken for theirs."""

    position: np.ndarray
    """[m, 3] unit frame"""
    normal: np.ndarray
    """[m, 3] unit vectors"""
    photo: np.ndarray
    """[m] int, index of the photo"""
    radiance: Tensor
    """[m, 3] linear"""
    sample: np.ndarray
    """[m, S] int64, indices of samples of the same photo whose light is averaged"""
    share: np.ndarray
    """[m, S] weights of these samples; they add up to 1"""
    width: float
    """Median width of a pixel on the surface, unit frame"""

    @classmethod
    def of(cls, pixels: Surfels, radiance: Tensor, samples: Surfels, width: float) -> PlacedPixels:
        """The pixels with the light of their nearest samples. Pixels of a photo without samples are left out."""
        sample, share = nearest_samples(samples, pixels)
        lit = np.flatnonzero(share.any(1))
        rows = torch.from_numpy(lit).to(radiance.device)
        position, normal, photo = (of_all[lit] for of_all in pixels)
        return cls(position, normal, photo, radiance[rows], sample[lit], share[lit], width)


def varied_points(
    materials: VariedMaterials, light: LightMoments, pixels: PlacedPixels, preset: MaterialPreset
) -> LabeledPoints:
    """The pixels as labeled points, each with an albedo of its own."""
    tree = cKDTree(pixels.position)
    radiance = pixels.radiance.float().cpu().numpy()
    color = median_color(tree, radiance, pixels.position, _MANY_PIXELS)
    material = materials.at(tree, color, pixels.width)
    offset, slope = _affine_of_pixels(material, light, pixels)
    around = neighbors(tree, pixels.position, _ALBEDO_PIXELS)
    there = Places(pixels.position, pixels.normal)
    distance, index = on_same_side(around, there, there)
    albedo, residual = np.empty_like(radiance), np.empty(len(radiance), np.float32)
    metallic = material.metallic.cpu().numpy()
    fit_local_albedos(
        index,
        kernel(distance).astype(np.float32),
        offset,
        slope,
        metallic,
        radiance,
        np.float32(preset.clip),
        _ITERATIONS,
        albedo,
        residual,
    )
    roughness = material.roughness.cpu().numpy()
    return LabeledPoints(pixels.position, pixels.normal, pixels.photo, albedo, roughness, metallic, residual)


def _affine_of_pixels(material: Material, light: LightMoments, pixels: PlacedPixels) -> tuple[np.ndarray, np.ndarray]:
    """Offset and slope [m, 3] of the pixels' radiance, with the light of their samples (`affine_in_albedo`), float32."""
    offset, slope = torch.zeros_like(material.albedo), torch.zeros_like(material.albedo)
    for k in range(pixels.sample.shape[1]):
        row = torch.from_numpy(pixels.sample[:, k]).to(offset.device)
        share = torch.from_numpy(pixels.share[:, k, None]).to(offset)
        moments = light.moments(material.roughness, row)
        terms = affine_in_albedo(material, moments, light.diffuse[row], light.cos_v[row])
        offset, slope = offset + share * terms[0], slope + share * terms[1]
    return offset.float().cpu().numpy(), slope.float().cpu().numpy()
