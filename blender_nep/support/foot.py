"""Closes the foot of the visual hull of an object that stands on a support plane, before the object field is learned.

No photo shows the object from below, and F_e alone does not know the support in the sphere. So the hull is hollow or frayed
near the plane. Where photos see the foot, learning corrects it; where they do not, it stays as it starts.
"""

from __future__ import annotations

import numpy as np
import torch
from scipy.ndimage import binary_fill_holes

from blender_nep.evidence.sdf_grid import SdfGrid, cell_centers, sampled, signed_distances
from blender_nep.support.plane import Support

FOOT = 0.15
"""The hull is closed from this height above the plane downwards, in object radii."""


def with_closed_foot(sdf: np.ndarray, support: Support) -> np.ndarray:
    """The SDF [n, n, n] at the centers of n^3 cells of [-1, 1]^3, united with a foot below the layer at height FOOT.

    The foot narrows downwards by 45 degrees: so it hardly ever fills what is free. Below the plane it goes straight on.
    """
    grid, axis = SdfGrid(sdf), cell_centers(len(sdf))
    points = grid.centers()
    height = support.distance(points)
    low = height < FOOT
    across, along = support.axes()
    layer = Support(support.normal, support.height + FOOT).square(axis)
    solid = binary_fill_holes(grid.sample(torch.from_numpy(layer)).numpy() < 0)
    distance = torch.from_numpy(signed_distances(solid, grid.cell))
    beside = sampled(distance, torch.from_numpy(np.stack([points[low] @ across, points[low] @ along], -1))).numpy()
    closed = sdf.copy()
    closed[low] = np.minimum(sdf[low], beside + FOOT - np.maximum(height[low], 0))
    return closed
