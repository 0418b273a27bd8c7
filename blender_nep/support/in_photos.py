"""Finds the plane on which the object stands from the photos alone, before any field is learned.

A table is nearly always larger than the object's sphere, and photos show it around the object. A point of its plane has the
same color in all photos that show it; a point of a wrong plane falls on other places of the table in each photo. So the
spread of the colors over the photos has a sharp minimum at the true plane (plane sweep, Collins 1996). The direction of the
normal follows from the cameras: people and tripods hold cameras upright. Then height and tilt are refined.

A glossy table has other colors in each photo, because it mirrors the surroundings, and so has a carpet in photos of a day
whose light changes. Where no plane is found by the colors, the details of the photos are compared (`by_details`).

A plate may end in the sphere. Where nothing is found beside the sphere, the colors inside the sphere are compared. There the
object hides the plane in many photos, so the share of the photos that agree counts.

No photo of an object on a table can be taken from below the table. So a plane with a camera below it is not a support.
"""

from __future__ import annotations

import numpy as np
import torch
from scipy.optimize import minimize

from blender_nep.capture.cameras.upright import upward
from blender_nep.capture.rays.pixel_rays import PixelRays
from blender_nep.evidence.agreement import majority, spread, views_that_show
from blender_nep.evidence.sdf_grid import cell_centers
from blender_nep.evidence.small_photos import SmallPhotos
from blender_nep.profiling import profiled
from blender_nep.support.by_details import plane_by_details
from blender_nep.support.plane import Support, ring

STEP = 0.025
"""Step of the sweep over heights, in object radii."""
LOWEST, HIGHEST = -0.98, -0.05
"""Range of heights of a support plane, from the sphere's center."""
RINGS = (0.15, 0.5)
"""The plane is compared in rings of these widths around the object's sphere: a plate may end soon, and a plain table may
show something only farther away."""
REFINE_RING = 1.0
"""The ring is so wide when the plane is refined: the wider, the better the tilt is known. Where the plane does not stand out
in this ring, because a plate ends before, the widest of RINGS is used in which it does."""
TILT_GAIN = 0.97
"""By this factor the spread must fall before the plane is tilted against the upward direction of the cameras."""
LEAST_CONTRAST = 1.3
"""By this factor the spread of the colors at the minimum must be below the spread REACH above and below it. Measured: 2.6
for a patterned table; at most 1.04 for seven objects without one, with the photos from above only."""
REACH = 0.08
"""A plane is compared with what lies so far above and below it, in object radii."""
INNER_CONTRAST = 1.1
"""By this factor, the share of the photos that agree on the colors inside the sphere must be above that REACH above and
below the plane. Measured: 1.16 for a patterned plate that ends in the sphere; at most 1.03 for nine objects without a
support, with the photos from above only, and 1.06 at a wrong height over a glossy plate."""
_NOISE = 0.002
"""A spread below this is noise, as on a plain wall."""
_LEAST_VIEWS = 4
"""A point is compared if at least so many photos show it, and at least a quarter of all."""
_SIDE = 50
"""The plane inside the sphere is looked at in so many points along each side of the square around it."""
_POINTS, _FINE_POINTS = 400, 1600
"""Number of points of a ring: in the sweep, and when the plane is refined."""


@profiled("support plane")
@torch.no_grad()
def support_in_photos(rays: PixelRays) -> Support | None:
    """The support plane of an object whose surroundings the photos show; None if they show no such plane.

    Takes a few seconds if no camera is below the object, and nearly no time otherwise.
    """
    up, heights = possible_planes(rays)
    if not len(heights):
        return None
    photos = SmallPhotos(rays)
    planes = [Support(up, float(height)) for height in heights]
    support = _outer_plane(photos, planes) or plane_by_details(photos, planes)
    if support is None:
        return _inner_plane(photos, planes)
    positions = np.stack([rays.camera(view)[0].double().cpu().numpy() for view in range(rays.views)])
    return support if (positions @ support.normal).min() > support.height else None


def possible_planes(rays: PixelRays) -> tuple[np.ndarray, np.ndarray]:
    """Upward direction [3], and the heights [n] at which a support plane may lie; none if a camera is below the object, or
    if the photos do not show the surroundings."""
    cameras = [[part.double().cpu().numpy() for part in rays.camera(view)] for view in range(rays.views)]
    positions, rotations = (np.stack(part) for part in zip(*cameras, strict=True))
    up = upward(rotations[:, :, 0], rotations[:, :, 1])
    lowest = float((positions @ up).min()) if rays.background else LOWEST
    return up, np.arange(LOWEST, min(HIGHEST, lowest), STEP)


def _outer_plane(photos: SmallPhotos, planes: list[Support]) -> Support | None:
    """The plane that stands out in a ring around the sphere, refined; None without one."""
    best, contrast = max((_best_plane(photos, planes, width) for width in RINGS), key=lambda found: found[1])
    if contrast < LEAST_CONTRAST:
        return None
    width = next(w for w in sorted((REFINE_RING, *RINGS), reverse=True) if _contrast(photos, best, w) >= LEAST_CONTRAST)
    return _refined(photos, best, width)


def _best_plane(photos: SmallPhotos, planes: list[Support], width: float) -> tuple[Support, float]:
    """The plane with the sharpest minimum of the spread in a ring of `width`, and its contrast."""
    found = np.array([_ring_spread(photos, plane, plane.radius, width) for plane in planes])
    minima = 1 + np.flatnonzero((found[1:-1] <= found[:-2]) & (found[1:-1] <= found[2:]) & np.isfinite(found[1:-1]))
    best, most = planes[0], 0.0
    for k in minima.tolist():
        contrast = _contrast(photos, planes[k], width)
        if contrast > most:
            best, most = planes[k], contrast
    return best, most


def _inner_plane(photos: SmallPhotos, planes: list[Support]) -> Support | None:
    """The plane on whose colors inside the sphere clearly more photos agree than REACH above and below; None without one.

    This finds a patterned plate that ends in the sphere.
    """
    axis, apart = cell_centers(_SIDE), round(REACH / STEP)

    def share(plane: Support) -> float:
        points = plane.square(axis).astype(np.float32)
        inside = torch.from_numpy(points[np.linalg.norm(points, axis=-1) < 1]).to(photos.photos.device)
        return float(majority(photos.colors(inside)).share.mean())

    if len(planes) <= 2 * apart:
        return None
    shares = np.array([share(plane) for plane in planes])
    contrast = shares[apart:-apart] / np.maximum(shares[: -2 * apart], shares[2 * apart :]).clip(1e-6)
    if contrast.max() < INNER_CONTRAST:
        return None
    found = planes[int(contrast.argmax()) + apart]
    return max((Support(found.normal, found.height + rise) for rise in np.linspace(-STEP, STEP, 9)), key=share)


def _ring_spread(photos: SmallPhotos, support: Support, inner: float, width: float) -> float:
    """Median spread of the points of a ring between the radii `inner` and `inner` + `width`; inf if hardly seen."""
    spreads = _spreads(photos, ring(support, inner, width, _POINTS))
    known = np.isfinite(spreads)
    return float(np.median(spreads[known])) if known.mean() >= 0.2 else float("inf")


def _spreads(photos: SmallPhotos, points: np.ndarray) -> np.ndarray:
    """The spread [n] float64 of the colors of points [n, 3]; NaN where hardly seen."""
    colors = photos.colors(torch.from_numpy(points.astype(np.float32)).to(photos.photos.device))
    seen = views_that_show(colors) >= max(_LEAST_VIEWS, len(colors) // 4)
    return torch.where(seen, spread(colors), torch.nan).double().cpu().numpy()


def _contrast(photos: SmallPhotos, plane: Support, width: float) -> float:
    """How many times larger the spread of a ring of `width` is REACH above and below the plane than in the plane."""
    below, here, above = (
        _ring_spread(photos, Support(plane.normal, plane.height + rise), plane.radius, width)
        for rise in (-REACH, 0.0, REACH)
    )
    return min(below, above) / max(here, _NOISE)


def _refined(photos: SmallPhotos, start: Support, width: float) -> Support:
    """The plane near `start` with the least spread in a ring of `width`.

    Its tilt changes only if that makes the spread clearly less.
    """
    level, at_level = start, np.inf
    for _ in range(2):
        level, at_level = _moved(photos, level, width, tilts=False)
    for _ in range(3):
        tilted, at_tilted = _moved(photos, level, width, tilts=True)
        if at_tilted >= TILT_GAIN * at_level:
            break
        level, at_level = tilted, at_tilted
    return level


def _moved(photos: SmallPhotos, start: Support, width: float, tilts: bool) -> tuple[Support, float]:
    """The plane near `start` with the least spread, by the method of Nelder and Mead in height and tilt, and the spread.

    Only those points of the ring are compared that agree best at the start: so neither the object in front of the plane
    nor what lies beyond its end disturbs. The points move along the normal of `start`.
    """
    points = ring(start, start.radius, width, _FINE_POINTS)
    # a little above and below, too: else those would be chosen that agree with the start by chance
    nearby = [_spreads(photos, points + rise * start.normal) for rise in (-0.5 * STEP, 0.0, 0.5 * STEP)]
    least = np.min(nearby, axis=0)
    points = points[least <= np.nanmedian(least)]
    across, along = start.axes()
    lever = np.stack([np.ones(len(points)), points @ across, points @ along], 1)[:, : 3 if tilts else 1]

    def mean_spread(x: np.ndarray) -> float:
        moved = _spreads(photos, points + (lever @ x)[:, None] * start.normal)
        return float(np.nanmean(moved)) if np.isfinite(moved).any() else float("inf")

    steps = np.array([0.5 * STEP, 0.02, 0.02])[: lever.shape[1]]
    simplex = np.concatenate([np.zeros((1, len(steps))), np.diag(steps)])
    options = {"initial_simplex": simplex, "xatol": 2e-4, "fatol": 1e-7, "maxfev": 80}
    found = minimize(mean_spread, simplex[0], method="Nelder-Mead", options=options)
    rise = np.pad(found.x, (0, 3 - len(steps)))
    normal = start.normal - rise[1] * across - rise[2] * along
    length = float(np.linalg.norm(normal))
    return Support(normal / length, (start.height + float(rise[0])) / length), float(found.fun)
