"""Tells from the photos alone whether an object has fine paint: colors that change within a tenth of its radius.

The photos are split into two halves. Each half gives the median color of every place of the surface. What these medians
differ from those around them is fine paint or chance. Paint is the same in both halves. Reflections and errors of the
surface are not.
"""

from __future__ import annotations

import numpy as np
import torch
from scipy import ndimage
from scipy.spatial import cKDTree

from blender_nep.capture.pixel_rays import PixelRays
from blender_nep.fields.surface_photos import SurfacePhotos, agreement, normals_of_cells, traced_mesh
from blender_nep.profiling import profiled

AROUND = 25
"""A place is compared with so many places around it. On the 64 cells of a hull, they lie within 0.1 radii."""
FAINT = 0.03
"""Fine colors that are weaker than this (tone-mapped) hardly count: the background shines through at edges in all photos."""
MOST_PLACES, LEAST_PLACES = 20_000, 200
"""At most so many places are compared, and with fewer nothing is said."""


@profiled("fine paint")
@torch.no_grad()
def fine_paint(rays: PixelRays, sdf: np.ndarray) -> float:
    """The correlation, -1..1, of the fine colors that the two halves of the photos show on the surface of an SDF [n, n, n].

    Near 0: the object has no fine paint, or it is faint, or the photos do not show it. 0 where they show too little of the
    surface.
    """
    shape, solid, cell = traced_mesh(sdf), sdf < 0, 2 / len(sdf)
    if shape is None:
        return 0.0
    surface = solid & ndimage.binary_dilation(~solid)
    place = np.stack(np.nonzero(surface), -1)
    normals = normals_of_cells(sdf, place)
    points = ((place + 0.5) * cell - 1 - normals * sdf[surface][:, None]).astype(np.float32)
    colors = SurfacePhotos(rays).colors(torch.from_numpy(points), torch.from_numpy(normals), shape, cell)
    (one, _, known), (other, _, known_too) = agreement(colors[0::2]), agreement(colors[1::2])
    shown = (known & known_too).numpy()
    if shown.sum() < LEAST_PLACES:
        return 0.0
    points, medians = points[shown], np.concatenate([one[shown].numpy(), other[shown].numpy()], 1)
    chosen = slice(None, None, -(-len(points) // MOST_PLACES))
    around = cKDTree(points).query(points[chosen], AROUND)[1]
    fine = medians[chosen] - medians[around].mean(1)
    one_half, other_half = fine[:, :3], fine[:, 3:]
    power = np.sqrt((one_half**2).mean() * (other_half**2).mean())
    return float((one_half * other_half).mean() / (power + FAINT**2))
