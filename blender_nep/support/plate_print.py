"""The print of a turntable's plate: the colors of the plane that photos agree on, in the object's sphere and beyond it.

A point of the plate has the same color in the photos that show it. What stands on the plate has other colors there in each
photo. An object of one plain color agrees, too, but it agrees as well a little above and below the plane. So a color of the
print must be sharp: more photos agree on it in the plane than beside it. A plain plate has hardly any sharp color.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from blender_nep.evidence.agreement import Majority, majority
from blender_nep.evidence.observation import colors_of, observe
from blender_nep.evidence.sdf_grid import cell_centers
from blender_nep.evidence.small_photos import SmallPhotos
from blender_nep.profiling import profiled
from blender_nep.support.agreed_colors import core_of
from blender_nep.support.in_photos import REACH
from blender_nep.support.plane import Support
from blender_nep.support.texture import PlaneTexture
from blender_nep.tone_mapping import inverse_tone_map

HALF_SIDE = 1.3
"""Half of the side of the square in which the print is looked for, in object radii. A plate may be wider than the sphere."""
LEAST_SHARE, LEAST_VIEWS = 0.2, 8
"""A color is known if more than this share of the photos that count agree on it, and if at least so many count. The share is
low, because what stands on the plate hides it in many photos."""
SHARP = 0.9
"""... and if at most this share of the share agrees REACH above and below the plane."""
_TEXELS = 100
"""Texels along each side of the square"""


@profiled("plate print")
@torch.no_grad()
def plate_print(photos: SmallPhotos, support: Support, sdf: np.ndarray | None = None) -> PlaneTexture:
    """The sharp colors of the plane. Takes one to two CPU seconds.

    sdf [n, n, n]: the object's shape as it is known so far, at the centers of n^3 cells of [-1, 1]^3, negative inside.
    Photos in which its core hides a point do not count for it. None: all count.
    """
    device = photos.photos.device
    square = torch.from_numpy(support.square(HALF_SIDE * cell_centers(_TEXELS)).astype(np.float32)).to(device)
    points, agreed = square.reshape(-1, 3), _agreement(photos, sdf)
    rise = REACH * torch.as_tensor(np.asarray(support.normal), dtype=points.dtype, device=device)
    found = agreed(points)
    known = (found.share > LEAST_SHARE) & (found.views >= LEAST_VIEWS)
    for moved in (points - rise, points + rise):
        known[known.clone()] = agreed(moved[known]).share < SHARP * found.share[known]
    return PlaneTexture(support, HALF_SIDE, inverse_tone_map(found.color).view_as(square), known.view(square.shape[:2]))


def _agreement(photos: SmallPhotos, sdf: np.ndarray | None) -> Callable[[Tensor], Majority]:
    """On what the photos agree at points [n, 3]."""
    if sdf is None:
        return lambda points: majority(photos.colors(points))
    return lambda points: majority(colors_of(observe(photos, points, occluder=core_of(sdf)), len(points)))
