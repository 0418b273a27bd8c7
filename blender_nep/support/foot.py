"""Closes the foot of the visual hull of an object that stands on a support plane, before the object field is learned.

No photo shows the object from below, and F_e alone does not know the support in the sphere. So the hull is hollow or frayed
near the plane. Where photos see the foot, learning corrects it; where they do not, it stays as it starts.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import binary_fill_holes, distance_transform_edt, map_coordinates

from blender_nep.support.plane import Support

FOOT = 0.15
"""The hull is closed from this height above the plane downwards, in object radii."""


def with_closed_foot(sdf: np.ndarray, support: Support) -> np.ndarray:
    """The SDF [n, n, n] at the centers of n^3 cells of [-1, 1]^3, united with a foot below the layer at height FOOT.

    The foot narrows downwards by 45 degrees: so it hardly ever fills what is free. Below the plane it goes straight on.
    """
    n = sdf.shape[0]
    axis = (np.arange(n) + 0.5) / n * 2 - 1
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1)
    height = support.distance(points)
    low = height < FOOT
    across, along = support.axes()
    layer = axis[:, None, None] * across + axis[None, :, None] * along + (support.height + FOOT) * np.asarray(support.normal)
    solid = binary_fill_holes(_sampled(sdf, layer) < 0)
    inside, outside = distance_transform_edt(solid), distance_transform_edt(~solid)
    # The distances are to centers of cells. The border lies half a cell nearer.
    distance = (outside - inside - np.sign(outside - inside) * 0.5) * (2 / n) if solid.any() else np.full((n, n), 1.0)
    beside = _sampled(distance, np.stack([points[low] @ across, points[low] @ along], -1))
    closed = sdf.copy()
    closed[low] = np.minimum(sdf[low], beside + FOOT - np.maximum(height[low], 0))
    return closed


def _sampled(grid: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Values [...] at points [..., d] of a grid [n, n, ...] whose values lie at the centers of cells of [-1, 1]^d."""
    place = np.moveaxis((points + 1) / 2 * grid.shape[0] - 0.5, -1, 0)
    return map_coordinates(grid, place, order=1, mode="nearest")
