"""Says where space is empty because photos show scene points that lie behind it.

A hull from photos and F_e keeps much that is free where F_e is blurred, as before a printed floor. There, structure from
motion finds most of its points.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import ndimage

Sightlines = Sequence[tuple[np.ndarray, np.ndarray]]
"""For each photo: the position [3] of its camera, and the scene points [n, 3] that it shows"""

_CELLS = 32
_PHOTOS = 2
"""A cell is free if so many photos look through it. One photo may have a wrong point, or a mirrored one."""
_BEFORE = 0.06
"""A line ends so far before its point, in radii: the point may lie on the object."""
_SMALL = 0.1
"""What is left of a hull is dropped where it is smaller than this share of the largest part."""


def seen_through(lines: Sightlines, center: np.ndarray, radius: float) -> np.ndarray:
    """The cells of a cube around a sphere that at least two photos look through: [32, 32, 32] bool."""
    photos = np.zeros(_CELLS**3, np.int64)
    share = np.linspace(0, 1, 3 * _CELLS)
    for position, points in lines:
        start, end = (position - center) / radius, (points - center) / radius
        length = np.linalg.norm(end - start, axis=1)
        direction = (end - start) / np.maximum(length, 1e-9)[:, None]
        middle = -(direction @ start)
        half = np.sqrt(np.maximum(1 - start @ start + middle**2, 0))
        near, far = np.maximum(middle - half, 0), np.minimum(middle + half, length - _BEFORE)
        through = far > near
        along = near[through, None] + (far - near)[through, None] * share
        place = start + along[..., None] * direction[through, None]
        cell = ((place + 1) / 2 * _CELLS).astype(np.int64).clip(0, _CELLS - 1)
        photos[np.unique(cell @ [_CELLS**2, _CELLS, 1])] += 1
    return (photos >= _PHOTOS).reshape(_CELLS, _CELLS, _CELLS)


def without_free_space(sdf: np.ndarray, free: np.ndarray) -> np.ndarray:
    """A hull [n, n, n] (negative inside) without what photos look through, [32, 32, 32]; the hull itself if nothing is left.

    A free cell may hold a part of the surface, so one more cell around what is left is kept.
    """
    cells, inside = len(sdf), sdf < 0
    coarse = np.arange(cells) * len(free) // cells
    kept = inside & ~free[np.ix_(coarse, coarse, coarse)]
    labels, count = ndimage.label(kept)
    if not count:
        return sdf
    size = np.bincount(labels.ravel())[1:]
    kept = np.isin(labels, 1 + np.flatnonzero(size >= _SMALL * size.max()))
    kept = ndimage.binary_dilation(kept, iterations=-(-cells // len(free))) & inside
    return np.where(kept, sdf, np.maximum(sdf, 1 / cells)).astype(sdf.dtype)
