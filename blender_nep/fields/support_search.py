"""Finds the plane on which the object stands from the photos alone, before any field is learned.

A table is nearly always larger than the object's sphere, and photos show it around the object. A point of its plane has the
same color in all photos that show it; a point of a wrong plane falls on other places of the table in each photo. So the
spread of the colors over the photos has a sharp minimum at the true plane (plane sweep, Collins 1996). The direction of the
normal follows from the cameras: people and tripods hold cameras upright. Then height and tilt are refined.

No photo of an object on a table can be taken from below the table. So a plane with a camera below it is not a support.
"""

from __future__ import annotations

import numpy as np
import torch
from scipy.optimize import minimize
from torch import Tensor
from torch.nn import functional

from blender_nep.capture.pixel_rays import PixelRays
from blender_nep.geometry.support import Support
from blender_nep.profiling import profiled
from blender_nep.tone_mapping import tone_map

STEP = 0.025
"""Step of the sweep over heights, in object radii."""
LOWEST, HIGHEST = -0.98, 0.2
"""Range of heights of a support plane, from the sphere's centre."""
RINGS = (0.15, 0.5)
"""The plane is compared in rings of these widths around the object's sphere: a plate may end soon, and a plain table may
show something only farther away."""
LEAST_CONTRAST = 1.3
"""By this factor the spread of the colors at the minimum must be below the spread REACH above and below it. Measured: 2.6
for a patterned table; at most 1.04 for seven objects without one, with the photos from above only."""
REACH = 0.08
_POINTS, _VIEWS, _ROWS = 400, 40, 200
"""Number of points of the ring, largest number of photos, and rows and columns to which the photos are resized."""


@profiled("support plane")
@torch.no_grad()
def find_support_by_photos(rays: PixelRays) -> Support | None:
    """The support plane of an object whose surroundings the photos show; None if they show no such plane.

    Takes a few seconds if no camera is below the object, and nearly no time otherwise.
    """
    if not rays.background:
        return None
    cameras = torch.stack([rays.camera(view)[0] for view in range(rays.views)]).double().cpu().numpy()
    up = upward(np.stack([rays.camera(view)[1].double().cpu().numpy() for view in range(rays.views)]))
    lowest = float((cameras @ up).min())
    if lowest <= LOWEST:
        return None
    photos = _Photos(rays)
    planes = [Support(up, float(height)) for height in np.arange(LOWEST, min(HIGHEST, lowest), STEP)]
    best, contrast, width = max((_best_plane(photos, planes, width) for width in RINGS), key=lambda found: found[1])
    if contrast < LEAST_CONTRAST:
        return None
    support = _refined(photos, best, width)
    return support if (cameras @ support.normal).min() > support.height else None


def _best_plane(photos: _Photos, planes: list[Support], width: float) -> tuple[Support, float, float]:
    """The plane with the sharpest minimum of the spread in a ring of `width`, its contrast, and the width.

    The contrast is how many times larger the spread of the same ring is REACH above and below the plane.
    """
    found = np.pad([photos.spread(plane, plane.radius, width) for plane in planes], 1, constant_values=np.inf)
    minima = np.flatnonzero((found[1:-1] <= found[:-2]) & (found[1:-1] <= found[2:]) & np.isfinite(found[1:-1]))
    best, most = planes[0], 0.0
    for k in minima.tolist():
        plane = planes[k]
        others = [photos.spread(Support(plane.normal, plane.height + d), plane.radius, width) for d in (-REACH, REACH)]
        contrast = min(others) / max(found[k + 1], 1e-6)
        if contrast > most:
            best, most = plane, contrast
    return best, most, width


def upward(rotations: np.ndarray) -> np.ndarray:
    """The upward direction [3] of cameras that are held upright, from their camera-to-world rotations [n, 3, 3].

    The horizontal axes of upright photos are horizontal, so the upward direction is the one that is most nearly
    orthogonal to all of them.
    """
    right, above = rotations[:, :, 0], rotations[:, :, 1]
    up = np.linalg.svd(right, full_matrices=True)[2][2]
    return up if (above @ up).sum() > 0 else -up


class _Photos:
    """Small tone-mapped photos, in which the colors of a plane's points are compared."""

    def __init__(self, rays: PixelRays) -> None:
        self.rays = rays
        self.views = range(0, rays.views, max(1, -(-rays.views // _VIEWS)))
        photos = []
        for view in self.views:
            height, width = rays.size[view]
            index = torch.arange(rays.offset[view], rays.offset[view + 1], device=rays.radiance.device)
            photo = tone_map(rays.photo(index)).reshape(1, height, width, 3).permute(0, 3, 1, 2)
            photos.append(functional.adaptive_avg_pool2d(photo, (_ROWS, _ROWS)))
        self.photos = torch.cat(photos)

    def spread(self, support: Support, inner: float, width: float) -> float:
        """Median over a ring of the median absolute difference of a point's colors from their median; inf if hardly seen.

        The ring lies in the plane, between the radii `inner` and `inner` + `width`.
        """
        points = torch.from_numpy(ring(support, inner, width).astype(np.float32)).to(self.photos.device)
        colors = self._colors(points)
        seen = torch.isfinite(colors[..., 0]).sum(0) >= max(4, len(self.photos) // 4)
        if seen.sum() < 0.2 * len(seen):
            return float("inf")
        colors = colors[:, seen]
        spread = (colors - colors.nanmedian(0).values).abs().nanmedian(0).values.mean(-1)
        return float(spread.median())

    def _colors(self, points: Tensor) -> Tensor:
        """Colors [views, n, 3] of points [n, 3]; NaN where a photo does not show the point."""
        found = [self.rays.project(view, points) for view in self.views]
        place, ahead = (torch.stack(part) for part in zip(*found, strict=True))
        colors = functional.grid_sample(self.photos, place[:, :, None], align_corners=False)[..., 0].transpose(1, 2)
        seen = ahead & (place.abs() < 1).all(-1)
        return torch.where(seen[..., None], colors, torch.nan)


def ring(support: Support, inner: float, width: float) -> np.ndarray:
    """Evenly spread points [n, 3] of the plane between the radii `inner` and `inner` + `width`: a Fibonacci spiral."""
    k = np.arange(_POINTS) + 0.5
    radius = np.sqrt(inner**2 + ((inner + width) ** 2 - inner**2) * k / _POINTS)
    angle = np.pi * (1 + np.sqrt(5)) * k
    across, along = support.axes()
    points = radius[:, None] * (np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * along)
    return points + support.height * np.asarray(support.normal)


def _refined(photos: _Photos, start: Support, width: float) -> Support:
    """The plane near `start` with the least spread, by the method of Nelder and Mead in height and tilt."""
    across, along = start.axes()

    def plane(x: np.ndarray) -> Support:
        normal = start.normal + x[1] * across + x[2] * along
        return Support(normal / np.linalg.norm(normal), float(x[0]))

    def spread(x: np.ndarray) -> float:
        return photos.spread(plane(x), start.radius, width)

    first = np.array([start.height, 0.0, 0.0])
    simplex = first + np.array([[0, 0, 0], [0.5 * STEP, 0, 0], [0, 0.02, 0], [0, 0, 0.02]])
    options = {"initial_simplex": simplex, "xatol": 5e-4, "fatol": 1e-6, "maxfev": 120}
    return plane(minimize(spread, first, method="Nelder-Mead", options=options).x)
