"""Finds the plane of a plain table, with the help of the visual hull.

Far from the object, a plain table looks the same at all heights, so `in_photos` does not find it. Near the foot it has
a texture: the object's shadow. There the object hides the plane in many photos, so only those photos are compared in which
the hull does not hide the point.

Below the true plane the colors agree nearly as well as in it, because the table is plain. Above it, the points fall on the
object, and the spread of their colors rises steeply. So the plane is the highest one above which the spread rises so.

An even backdrop, black or white, agrees at all heights, and the object before it makes the spread rise. It has no texture at
all. So a plane also needs a texture: the colors of its points on which the photos agree differ from point to point.
"""

from __future__ import annotations

import numpy as np
import torch
from scipy.ndimage import distance_transform_edt
from torch import Tensor

from blender_nep.capture.rays.pixel_rays import PixelRays
from blender_nep.evidence.agreement import median_of_photos, spread, views_that_show
from blender_nep.evidence.observation import colors_of, observe
from blender_nep.evidence.occluders import SdfOccluder
from blender_nep.evidence.sdf_grid import SdfGrid
from blender_nep.evidence.small_photos import SmallPhotos
from blender_nep.profiling import profiled
from blender_nep.support.in_photos import STEP, possible_planes
from blender_nep.support.plane import Support

MOST_SPREAD = 0.035
"""Largest tone-mapped spread of a support's colors. Measured: 0.007 to 0.019 on tables and plates (0.038 under a mirror on a
plain plate); at least 0.05 at all heights where the object floats."""
NEAR_LEAST, LOW_SHARE = 1.25, 0.1
"""The spread of the plane is at most NEAR_LEAST times the LOW_SHARE quantile of all spreads up to its height. The least of
them may be small by chance, because few points of the lowest planes are seen."""
RISE, LEAST_RISE = 0.1, 1.4
"""RISE above the plane, in object radii, the spread must have grown by the factor LEAST_RISE."""
LEAST_TEXTURE = 0.01
"""The colors of a support on which photos agree differ at least by this (`_NearFoot.texture`). Measured: 0.044 to 0.10 on
tables and plates, plain ones too; 0 in front of black, and at most 0.004 where black is noisy by 0.02."""
NEAREST, FARTHEST = 0.03, 0.35
"""Distances from the foot, in object radii, between which points of the plane are compared."""
LIFT = 0.05
"""The foot is the section of the hull at this height above the plane. What is lower does not hide the plane."""
_SIDE, _CELL = 1.2, 0.05
"""Half width of the square of the plane that is looked at, and the spacing of its points."""
_LEAST_VIEWS, _LEAST_POINTS = 6, 30
_FIRST, _LAST, _STEPS = 0.06, 1.6, 40
"""Whether the hull hides a point is asked at so many distances, between these, on the way to the camera."""


@profiled("support plane")
@torch.no_grad()
def support_at_foot(rays: PixelRays, hull_sdf: np.ndarray) -> Support | None:
    """The support plane of an object with this visual hull; None if the photos show none.

    hull_sdf [n, n, n] belongs to the centers of n^3 cells of [-1, 1]^3, negative inside. Takes 1 to 2 CPU seconds if no
    camera is below the object, and nearly no time otherwise.
    """
    up, heights = possible_planes(rays)
    if not len(heights):
        return None
    near_foot = _NearFoot(rays, hull_sdf, up)
    spreads = np.array([near_foot.spread(float(height)) for height in heights])
    for k in range(len(spreads) - 1 - round(RISE / STEP), -1, -1):
        agrees = spreads[k] <= MOST_SPREAD and spreads[k] <= NEAR_LEAST * np.nanquantile(spreads[: k + 1], LOW_SHARE)
        rises = spreads[k + round(RISE / STEP)] >= LEAST_RISE * spreads[k]
        if agrees and rises and near_foot.texture(float(heights[k])) >= LEAST_TEXTURE:
            return Support(up, float(heights[k]))
    return None


class _NearFoot:
    """Compares the photos around the foot that an object would have on a plane."""

    def __init__(self, rays: PixelRays, hull_sdf: np.ndarray, up: np.ndarray) -> None:
        self._photos, self._up, self._hull = SmallPhotos(rays), up, SdfGrid(hull_sdf)
        self._device = rays.radiance.device
        axis = np.arange(-_SIDE, _SIDE, _CELL)
        across, along = Support(up, 0.0).axes()
        self._square = axis[:, None, None] * across + axis[None, :, None] * along

    def spread(self, height: float) -> float:
        """Median spread of the colors around the foot on the plane at `height`; NaN where hardly anything is seen."""
        colors = self._colors(height)
        return float("nan") if colors is None else float(spread(colors).median())

    def texture(self, height: float) -> float:
        """How much the colors on which the photos agree differ around the foot; NaN where hardly anything is seen.

        It is the range of the middle half of the points' median colors, in the channels' mean. Only the half of the points
        on which the photos agree best counts. The others may lie on the object, and some of these may, too.
        """
        colors = self._colors(height)
        if colors is None:
            return float("nan")
        spreads = spread(colors)
        agreed = median_of_photos(colors)[spreads <= spreads.median()]
        return float((agreed.quantile(0.75, 0) - agreed.quantile(0.25, 0)).mean())

    def _colors(self, height: float) -> Tensor | None:
        """Colors [views, n, 3] of the points around the foot on the plane at `height`, NaN where a photo does not show one;
        None where hardly anything is seen."""
        up = self._tensor(self._up)
        points = self._tensor(self._square + height * self._up)
        foot = (self._hull.sample(points + LIFT * up) < 0).cpu().numpy()
        if not foot.any():
            return None
        distance = distance_transform_edt(~foot) * _CELL
        points = points[torch.from_numpy((distance > NEAREST) & (distance < FARTHEST)).to(points.device)]
        occluder = SdfOccluder(
            self._hull,
            level=self._hull.cell,  # a cell larger than the hull, which may be too small by as much
            first=_FIRST,
            last=_LAST,
            steps=_STEPS,
            counts=lambda places: places @ up > height + LIFT,
        )
        colors = colors_of(observe(self._photos, points, occluder=occluder), len(points))
        seen = views_that_show(colors) >= _LEAST_VIEWS
        return colors[:, seen] if int(seen.sum()) >= _LEAST_POINTS else None

    def _tensor(self, array: np.ndarray) -> Tensor:
        return torch.from_numpy(array.astype(np.float32)).to(self._device)
