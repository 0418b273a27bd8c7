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

STEP = 0.02
"""Step of the sweep over heights, in object radii."""
LOWEST, HIGHEST = -0.98, 0.2
"""Range of heights of a support plane, from the sphere's centre."""
RING = 0.5
"""The plane is compared in a ring of this width around the object's sphere."""
LEAST_CONTRAST = 1.3
"""By this factor the spread of the colors at the minimum must be below the spread REACH above and below it. Measured: 2.6
for a patterned table; at most 1.04 for seven objects without one, with the photos from above only."""
REACH = 0.08
_POINTS, _VIEWS, _WIDTH = 600, 40, 200
"""Number of points of the ring, largest number of photos, and width of the photos in pixels (about)."""


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
    spread = _Spread(rays)
    planes = [Support(up, float(height)) for height in np.arange(LOWEST, min(HIGHEST, lowest), STEP)]
    found = np.pad([spread(plane) for plane in planes], 1, constant_values=np.inf)
    minima = np.flatnonzero((found[1:-1] <= found[:-2]) & (found[1:-1] <= found[2:]) & np.isfinite(found[1:-1]))
    contrast = {k: _contrast(spread, planes[k], found[k + 1]) for k in minima.tolist()}
    best = max(contrast, key=contrast.__getitem__, default=None)
    if best is None or contrast[best] < LEAST_CONTRAST:
        return None
    support = _refined(spread, planes[best])
    return support if (cameras @ support.normal).min() > support.height else None


def _contrast(spread: _Spread, plane: Support, at_plane: float) -> float:
    """How many times larger than `at_plane` the spread of the same ring is, REACH above and below the plane."""
    others = [spread(Support(plane.normal, plane.height + step), plane.radius) for step in (-REACH, REACH)]
    return min(others) / max(at_plane, 1e-6)


def upward(rotations: np.ndarray) -> np.ndarray:
    """The upward direction [3] of cameras that are held upright, from their camera-to-world rotations [n, 3, 3].

    The horizontal axes of upright photos are horizontal, so the upward direction is the one that is most nearly
    orthogonal to all of them.
    """
    right, above = rotations[:, :, 0], rotations[:, :, 1]
    up = np.linalg.svd(right, full_matrices=True)[2][2]
    return up if (above @ up).sum() > 0 else -up


class _Spread:
    """Computes how much the colors of a plane's points differ over the photos."""

    def __init__(self, rays: PixelRays) -> None:
        self.rays = rays
        self.views = range(0, rays.views, max(1, -(-rays.views // _VIEWS)))
        self.photos = []
        for view in self.views:
            height, width = rays.size[view]
            index = torch.arange(rays.offset[view], rays.offset[view + 1], device=rays.radiance.device)
            photo = tone_map(rays.photo(index)).reshape(1, height, width, 3).permute(0, 3, 1, 2)
            self.photos.append(functional.avg_pool2d(photo, max(1, round(width / _WIDTH))))

    def __call__(self, support: Support, inner: float | None = None) -> float:
        """Median over the ring of the median absolute difference of a point's colors from their median.

        The ring begins at the radius `inner`; by default, at the sphere.
        """
        points = ring(support, support.radius if inner is None else inner)
        colors = self._colors(torch.from_numpy(points.astype(np.float32)).to(self.rays.radiance.device))
        seen = torch.isfinite(colors[..., 0]).sum(0) >= max(4, len(self.photos) // 4)
        if seen.sum() < 0.2 * len(seen):
            return float("inf")
        colors = colors[:, seen]
        spread = (colors - colors.nanmedian(0).values).abs().nanmedian(0).values.mean(-1)
        return float(spread.median())

    def _colors(self, points: Tensor) -> Tensor:
        """Tone-mapped colors [views, n, 3] of points [n, 3]; NaN where a photo does not show the point."""
        colors = []
        for view, photo in zip(self.views, self.photos, strict=True):
            place, ahead = self.rays.project(view, points)
            color = functional.grid_sample(photo, place[None, :, None], align_corners=False)[0, :, :, 0].T
            seen = ahead & (place.abs() < 1).all(-1)
            colors.append(torch.where(seen[:, None], color, torch.nan))
        return torch.stack(colors)


def ring(support: Support, inner: float) -> np.ndarray:
    """Evenly spread points [n, 3] of the plane between the radii `inner` and `inner` + RING: a Fibonacci spiral."""
    k = np.arange(_POINTS) + 0.5
    radius = np.sqrt(inner**2 + ((inner + RING) ** 2 - inner**2) * k / _POINTS)
    angle = np.pi * (1 + np.sqrt(5)) * k
    across, along = support.axes()
    points = radius[:, None] * (np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * along)
    return points + support.height * np.asarray(support.normal)


def _refined(spread: _Spread, start: Support) -> Support:
    """The plane near `start` with the least spread, by the method of Nelder and Mead in height and tilt."""
    across, along = start.axes()

    def plane(x: np.ndarray) -> Support:
        normal = start.normal + x[1] * across + x[2] * along
        return Support(normal / np.linalg.norm(normal), float(x[0]))

    first = np.array([start.height, 0.0, 0.0])
    simplex = first + np.array([[0, 0, 0], [0.5 * STEP, 0, 0], [0, 0.02, 0], [0, 0, 0.02]])
    options = {"initial_simplex": simplex, "xatol": 5e-4, "fatol": 1e-6, "maxfev": 120}
    return plane(minimize(lambda x: spread(plane(x)), first, method="Nelder-Mead", options=options).x)
