"""What is known in the end of which material lies where: by the samples, or by far more pixels."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch
from scipy.spatial import cKDTree

from blender_nep.materials.baking import NEIGHBOURS, LabelledPoints, neighbours, weighted_mean
from blender_nep.materials.photo_samples import select_samples
from blender_nep.materials.pixel_votes import Surfels, left_out_error, pixel_costs
from blender_nep.profiling import profiled
from blender_nep.tone_mapping import tone_map

if TYPE_CHECKING:
    from blender_nep.capture.pixel_rays import PixelRays
    from blender_nep.geometry.ray_tracing import RayTracer
    from blender_nep.materials.palette_search import PaletteSearch
    from blender_nep.materials.photo_samples import PhotoSamples

_CANDIDATES = 3
"""Pixels looked at for each label pixel: nearly all that show the surface become one, so there is little to choose."""


def labelled_samples(search: PaletteSearch) -> LabelledPoints:
    """Of those that the light was gathered for."""
    cost = search.costs().cpu().numpy()
    label = search.label.cpu().numpy()
    own = cost[np.arange(len(label)), label] / search.weight.cpu().numpy()
    return LabelledPoints(
        search.samples.position,
        search.samples.photo.cpu().numpy(),
        search.smoothed(cost),
        search.palette.albedo.cpu().numpy()[label],
        own,
    )


def error_of_neighbours(search: PaletteSearch, samples: Surfels, shown: np.ndarray) -> float:
    """Median error with which the other samples of its photo tell what a sample shows of its own material."""
    label = search.label.cpu().numpy()
    return float(np.median(left_out_error(samples, shown)[np.arange(len(label)), label]))


@profiled("votes of all pixels")
def labelled_pixels(
    search: PaletteSearch,
    samples: Surfels,
    shown: np.ndarray,
    rays: PixelRays,
    tracer: RayTracer,
    normals: np.ndarray,
    seed: int,
) -> LabelledPoints:
    """Of `preset.label_pixels` pixels, by the light of the samples beside them: boundaries are as sharp as the photos.

    shown [n,K,3]: what each sample shows of each material, tone-mapped."""
    p, palette = search.preset, search.palette
    label_pixels = select_samples(
        rays,
        tracer,
        normals,
        count=p.label_pixels,
        least_cosine=p.least_cosine,
        generator=np.random.default_rng(seed),
        candidates=_CANDIDATES,
    )
    pixels = surfels(label_pixels, tracer, normals)
    cost = pixel_costs(samples, shown, pixels, tone_map(label_pixels.radiance).cpu().numpy(), p.clip)
    cost = cost * torch.where(palette.blended, 1 + p.blend_margin, 1.0).cpu().numpy()
    smoothed = weighted_mean(cost, *neighbours(cKDTree(pixels.position), pixels.position, 2 * NEIGHBOURS))
    label = smoothed.argmin(1)
    return LabelledPoints(
        pixels.position, pixels.photo, smoothed, palette.albedo.cpu().numpy()[label], cost[np.arange(len(cost)), label]
    )


def surfels(samples: PhotoSamples, tracer: RayTracer, normals: np.ndarray) -> Surfels:
    """Where samples see the surface, with the vertices' normals [V,3] between them."""
    return Surfels(
        samples.position, tracer.smooth_normals(normals, samples.face, samples.barycentric), samples.photo.cpu().numpy()
    )
