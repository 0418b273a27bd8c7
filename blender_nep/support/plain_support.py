"""Finds the plane of a plain table, with the help of the visual hull.

Far from the object, a plain table looks the same at all heights, so `support_search` does not find it. Near the foot it has
a texture: the object's shadow. There the object hides the plane in many photos, so only those photos are compared in which
the hull does not hide the point.

Below the true plane the colors agree nearly as well as in it, because the table is plain. Above it, the points fall on the
object, and the spread of their colors rises steeply. So the plane is the highest one above which the spread rises so.
"""

from __future__ import annotations

import numpy as np
import torch
from scipy.ndimage import distance_transform_edt
from torch import Tensor
from torch.nn import functional

from blender_nep.capture.rays.pixel_rays import PixelRays
from blender_nep.evidence.small_photos import SmallPhotos
from blender_nep.profiling import profiled
from blender_nep.support.plane import Support
from blender_nep.support.search import STEP, possible_planes

MOST_SPREAD = 0.035
"""Largest tone-mapped spread of a support's colors. Measured: 0.007 to 0.019 on tables and plates (0.038 under a mirror on a
plain plate); at least 0.05 at all heights where the object floats."""
NEAR_LEAST, LOW_SHARE = 1.25, 0.1
"""The spread of the plane is at most NEAR_LEAST times the LOW_SHARE quantile of all spreads up to its height. The least of
them may be small by chance, because few points of the lowest planes are seen."""
RISE, LEAST_RISE = 0.1, 1.4
"""RISE above the plane, in object radii, the spread must have grown by the factor LEAST_RISE."""
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
def find_plain_support(rays: PixelRays, hull_sdf: np.ndarray) -> Support | None:
    """The support plane of an object with this visual hull; None if the photos show none.

    hull_sdf [n, n, n] belongs to the centers of n^3 cells of [-1, 1]^3, negative inside. Takes 1 to 2 CPU seconds if no
    camera is below the object, and nearly no time otherwise.
    """
    up, heights = possible_planes(rays)
    if not len(heights):
        return None
    near_foot = _NearFoot(rays, hull_sdf, up)
    spread = np.array([near_foot.spread(float(height)) for height in heights])
    for k in range(len(spread) - 1 - round(RISE / STEP), -1, -1):
        agrees = spread[k] <= MOST_SPREAD and spread[k] <= NEAR_LEAST * np.nanquantile(spread[: k + 1], LOW_SHARE)
        if agrees and spread[k + round(RISE / STEP)] >= LEAST_RISE * spread[k]:
            return Support(up, float(heights[k]))
    return None


class _NearFoot:
    """Compares the photos around the foot that an object would have on a plane."""

    def __init__(self, rays: PixelRays, hull_sdf: np.ndarray, up: np.ndarray) -> None:
        self._photos, self._up = SmallPhotos(rays), up
        device = rays.radiance.device
        self._cameras = [rays.camera(view)[0].to(device) for view in self._photos.views]
        self._sdf = torch.from_numpy(hull_sdf.astype(np.float32)).to(device)[None, None]
        self._margin = 2 / len(hull_sdf)
        axis = np.arange(-_SIDE, _SIDE, _CELL)
        across, along = Support(up, 0.0).axes()
        self._square = axis[:, None, None] * across + axis[None, :, None] * along

    def spread(self, height: float) -> float:
        """Median spread of the colors around the foot on the plane at `height`; NaN where hardly anything is seen."""
        points = self._tensor(self._square + height * self._up)
        foot = (self._hull(points + LIFT * self._tensor(self._up)) < 0).cpu().numpy()
        if not foot.any():
            return float("nan")
        distance = distance_transform_edt(~foot) * _CELL
        points = points[torch.from_numpy((distance > NEAREST) & (distance < FARTHEST)).to(points.device)]
        colors = self._photos.colors(points)
        colors[torch.stack([self._hidden(points, camera, height) for camera in self._cameras])] = torch.nan
        seen = torch.isfinite(colors[..., 0]).sum(0) >= _LEAST_VIEWS
        if int(seen.sum()) < _LEAST_POINTS:
            return float("nan")
        colors = colors[:, seen]
        return float((colors - colors.nanmedian(0).values).abs().nanmedian(0).values.mean(-1).median())

    def _hidden(self, points: Tensor, camera: Tensor, height: float) -> Tensor:
        """Whether the hull, which is taken a cell larger, hides each point [n, 3] from the camera [3]: [n] bool."""
        direction = functional.normalize(camera - points, dim=-1)
        way = torch.linspace(_FIRST, _LAST, _STEPS, device=points.device)
        between = points[:, None] + way[:, None] * direction[:, None]
        lifted = between @ self._tensor(self._up) > height + LIFT
        return (lifted & (self._hull(between) < self._margin)).any(1)

    def _hull(self, points: Tensor) -> Tensor:
        """The hull's SDF [...] at points [..., 3]; outside the cube, that of its border."""
        place = points.flip(-1).reshape(1, 1, 1, -1, 3)
        found = functional.grid_sample(self._sdf, place, align_corners=False, padding_mode="border")
        return found.reshape(points.shape[:-1])

    def _tensor(self, array: np.ndarray) -> Tensor:
        return torch.from_numpy(array.astype(np.float32)).to(self._sdf.device)
