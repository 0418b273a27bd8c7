"""Finds photos that are clearly more blurred than photos of the same things.

Blur takes away fine detail and leaves coarse detail. So the energy of second differences between neighboring pixels is
divided by the energy of differences between pixels that are four apart. Motion blurs in one direction only: four directions
are measured, and the lowest counts. How much fine detail there is depends on what a photo shows. So each photo is compared
with the photos that were taken from the nearest directions.

The photos are measured in the size that learning uses. Blur that is narrower than a pixel of that size does no harm.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from blender_nep.capture.rays.pixel_rays import PixelRays
from blender_nep.tone_mapping import tone_map

DIRECTIONS = ((0, 1), (1, 0), (1, 1), (1, -1))
"""Steps in rows and columns along which differences are taken"""
COARSE = 4
"""Distance in steps of the pixels whose difference is coarse detail"""
BRIGHTEST_EDGE = 0.05
"""A squared difference of tone-mapped values counts at most this much, so that a few highlights do not decide."""
NEIGHBORS = 8
"""Number of photos from the nearest directions with which a photo is compared"""
LEAST_PHOTOS = 6
"""With fewer photos, nothing is said."""
LEAST_LOSS = math.log(2)
"""A photo is blurred if it has less than half of its neighbors' fine detail. Measured on sharp photos: at most a loss of
0.64; with a Gaussian blur of one pixel's standard deviation, 0.7 to 1.7."""
LEAST_DEVIATIONS = 4.0
"""... and if its loss is this many times the usual deviation of the photos from their neighbors. Measured: mostly up to 4
for sharp photos, 4.4 to 17 with that blur."""
SMALLEST_DEVIATION = 0.1
"""Rendered photos have no smaller deviation, and a usual deviation under this value is taken as this value."""


def blurred(rays: PixelRays) -> list[int]:
    """The photos that are clearly more blurred than those from nearby directions, in rising order."""
    measured = [_fine_detail(rays, view) for view in range(rays.views)]
    known = [view for view, detail in enumerate(measured) if detail is not None]
    if len(known) < LEAST_PHOTOS:
        return []
    detail = np.stack([found for found in measured if found is not None])
    place = np.stack([rays.camera(view)[0].cpu().numpy() for view in known])
    direction = place / np.linalg.norm(place, axis=1, keepdims=True)
    cosine = direction @ direction.T
    np.fill_diagonal(cosine, -np.inf)
    nearest = np.argsort(-cosine, axis=1)[:, :NEIGHBORS]
    loss = np.median(detail[nearest], axis=1) - detail
    deviation = 1.4826 * np.median(np.abs(loss - np.median(loss, axis=0)), axis=0)
    lost = (loss > LEAST_LOSS) & (loss > LEAST_DEVIATIONS * np.maximum(deviation, SMALLEST_DEVIATION))
    return [known[i] for i in np.flatnonzero(lost.any(1))]


def _fine_detail(rays: PixelRays, view: int) -> np.ndarray | None:
    """Logarithm of fine by coarse energy [4], for each of DIRECTIONS. None for a photo that shows nothing.

    For cut-outs, only the object's pixels count.
    """
    height, width = rays.size[view]
    start, end = rays.offset[view : view + 2]
    used = rays.valid[start:end]
    if rays.mask is not None and not rays.background:
        used = used & (rays.mask[start:end] == 255)
    brightness = rays.radiance[start:end].float().mean(-1)
    middle = brightness[used].median() if used.any() else brightness.new_zeros(())
    if middle <= 0 or min(height, width) <= 2 * COARSE:
        return None
    value = tone_map(brightness / (2 * middle)).view(height, width)
    used = used.view(height, width)
    found = []
    for row, column in DIRECTIONS:
        before, here, after = (_moved(value, row * k, column * k) for k in (-1, 0, 1))
        fine_used = torch.stack([_moved(used, row * k, column * k) for k in (-1, 0, 1)]).all(0)
        coarse = _moved(value, row * COARSE, column * COARSE) - here
        coarse_used = _moved(used, row * COARSE, column * COARSE) & _moved(used, 0, 0)
        energies = (_energy(before - 2 * here + after, fine_used), _energy(coarse, coarse_used))
        found.append(math.log(energies[0] / energies[1]))
    return np.array(found)


def _moved(image: Tensor, rows: int, columns: int) -> Tensor:
    """The image [H, W] without COARSE pixels at each edge, of the place that lies `rows` and `columns` away."""
    height, width = image.shape
    return image[COARSE + rows : height - COARSE + rows, COARSE + columns : width - COARSE + columns]


def _energy(difference: Tensor, used: Tensor) -> float:
    """Mean squared difference over the used pixels, and a little, so that it is positive."""
    return float((difference.square().clamp(max=BRIGHTEST_EDGE) * used).sum() / used.sum().clamp(min=1)) + 1e-8
