"""Labels points of the surface with materials: the photo samples, or many more pixels (the label pixels)."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import cKDTree

from blender_nep.materials.baking import NEIGHBORS, Places, neighbors, on_same_side, weighted_mean
from blender_nep.materials.labels.blending import BlendedPoints, find_blends
from blender_nep.materials.labels.pixel_votes import Surfels, left_out_error, pixel_costs
from blender_nep.materials.samples.photo_samples import select_samples
from blender_nep.profiling import profiled
from blender_nep.tone_mapping import tone_map

if TYPE_CHECKING:
    from blender_nep.capture.rays.pixel_rays import PixelRays
    from blender_nep.geometry.ray_tracing import RayTracer
    from blender_nep.materials.palette.palette import Palette
    from blender_nep.materials.palette.search import FoundPalette, PaletteSearch
    from blender_nep.materials.samples.photo_samples import PhotoSamples
    from blender_nep.presets import MaterialPreset

_NEVER = 1e3
"""The cost of a material that is not there. It is far above all residuals."""
_CANDIDATES = 3
"""Pixels that are tried for each label pixel. Nearly all pixels that show the surface become label pixels, so few are
enough."""
_WIDER, _STRIDE = 32, 4
"""The wider surroundings of a label pixel: of every fourth label pixel, the 32 nearest. Each cost is already a mean over
neighbors, so fewer pixels are enough."""


def labeled_samples(search: PaletteSearch, found: FoundPalette) -> BlendedPoints:
    """The photo samples, for which the light was gathered, as blended points."""
    cost = search.costs(found.palette).cpu().numpy()
    label = found.label.cpu().numpy()
    own = cost[np.arange(len(label)), label] / search.weight.cpu().numpy()
    samples = Surfels(*search.places, search.samples.photo.cpu().numpy())
    smoothed = possible(search.smoothed(cost), search.excluded(found, search.places))
    return BlendedPoints(*samples, own, *find_blends(smoothed, found.palette, search.preset.blend_margin))


def possible(cost: np.ndarray, excluded: np.ndarray | None) -> np.ndarray:
    """The costs [n, K] with `_NEVER` for the materials that are `excluded` [n, K]; None: no material is."""
    return cost if excluded is None else np.where(excluded, _NEVER, cost)


def error_of_neighbors(found: FoundPalette, samples: Surfels, shown: np.ndarray) -> float:
    """Median error of predicting a sample's radiance from the nearest other samples of the same photo.

    The radiance is that of the sample's own material, tone-mapped; shown [n, K, 3] is that of every material.
    """
    label = found.label.cpu().numpy()
    return float(np.median(left_out_error(samples, shown)[np.arange(len(label)), label]))


@profiled("votes of all pixels")
def labeled_pixels(
    palette: Palette,
    preset: MaterialPreset,
    samples: Surfels,
    shown: np.ndarray,
    rays: PixelRays,
    tracer: RayTracer,
    normals: np.ndarray,
    seed: int,
    excluded: Callable[[Places], np.ndarray | None],
) -> BlendedPoints:
    """At most `preset.label_pixels` pixels as blended points, so that boundaries are as sharp as the photos.

    The light of a pixel is taken from the nearest samples of its photo. shown [n, K, 3] is the tone-mapped radiance that
    each sample would have with each material. excluded(places) tells which materials places cannot have (`possible`).
    """
    p = preset
    label_pixels = select_label_pixels(rays, tracer, normals, p, seed)
    pixels = surfels(label_pixels, tracer, normals)
    cost = pixel_costs(samples, shown, pixels, tone_map(label_pixels.radiance).cpu().numpy(), p.clip)
    blended = palette.blended.cpu().numpy()
    cost = cost * np.where(blended, 1 + p.blend_margin, 1.0)
    tree = cKDTree(pixels.position)
    there = Places(pixels.position, pixels.normal)
    around = on_same_side(neighbors(tree, pixels.position, 2 * NEIGHBORS), there, there)
    smoothed = weighted_mean(cost, *around)
    inner = shows_one_material(smoothed, blended, tree)
    smoothed = possible(smoothed, excluded(there))
    smoothed[np.ix_(inner, blended)] *= (1 + p.inner_blend_margin) / (1 + p.blend_margin)
    own = cost[np.arange(len(cost)), smoothed.argmin(1)]
    return BlendedPoints(*pixels, own, *find_blends(smoothed, palette, p.blend_margin))


def shows_one_material(cost: np.ndarray, blended: np.ndarray, tree: cKDTree) -> np.ndarray:
    """Whether one material alone explains the wider surroundings of each point best, [n] bool.

    cost [n, K] are the residuals of the n points in `tree`; blended [K] says which of the K are mixtures of two materials.
    """
    if not blended.any():
        return np.zeros(len(cost), bool)
    around = neighbors(cKDTree(tree.data[::_STRIDE]), tree.data, _WIDER)[1] * _STRIDE
    return ~blended[np.stack([column[around].mean(1) for column in cost.T], 1).argmin(1)]


def select_label_pixels(
    rays: PixelRays, tracer: RayTracer, normals: np.ndarray, preset: MaterialPreset, seed: int
) -> PhotoSamples:
    """At most `preset.label_pixels` pixels that show the surface well."""
    return select_samples(
        rays,
        tracer,
        normals,
        count=preset.label_pixels,
        least_cosine=preset.least_cosine,
        generator=np.random.default_rng(seed),
        candidates=_CANDIDATES,
    )


def surfels(samples: PhotoSamples, tracer: RayTracer, normals: np.ndarray) -> Surfels:
    """Where the samples see the surface. Their normals are interpolated from the vertices' normals [V, 3]."""
    return Surfels(
        samples.position, tracer.smooth_normals(normals, samples.face, samples.barycentric), samples.photo.cpu().numpy()
    )
