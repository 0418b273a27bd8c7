"""Finds the plane on which the object stands by the details that photos show of it: the weave of a carpet, grain, scratches.

Colors of a table differ from photo to photo by gloss, shadows, exposure and white balance. Its details stay where they are.
So the plane is swept through the photos (plane sweep, Collins 1996), and at each height the photos' details are correlated.
Each photo's details on a ring of the plane are divided by their own standard deviation, so that neither brightness nor
contrast counts. At the true height the photos correlate, and elsewhere they do not.
"""

from __future__ import annotations

import numpy as np
import torch
from scipy.optimize import minimize
from torch import Tensor

from blender_nep.evidence.small_photos import SmallPhotos
from blender_nep.profiling import profiled
from blender_nep.support.plane import Support, ring

FINE = 4.0
"""Details are finer than this, in rows of the small photos. What is wider is shading and gloss."""
LEAST_CORRELATION, STANDS_OUT = 0.03, 2.0
"""A plane has at least the first correlation, and the second number times that of all heights that are APART away. Measured
on a carpet in three selections of hand-held photos: 0.065 to 0.091, and 2.5 to 10 times. On three rendered tables: 0.039 to
0.55, and 2.6 to 20 times. At most 0.007 for seven objects without a table, with the photos from above only, and 0.026 for a
real cape."""
APART = 0.08
"""Heights that differ by more, in object radii, are other planes."""
TILT_GAIN = 1.05
"""By this factor the correlation must rise before the plane is tilted against the upward direction of the cameras."""
_WIDTHS = (0.15, 0.5, 1.0)
"""The plane is sought in rings of these widths around the object's sphere: a plate may end soon, and a plain table may show
something only farther away. The ring counts in which the plane stands out most."""
_INNER = 0.75
"""It is refined in a ring that begins in the sphere, at this share of the radius of the plane's disc in it: a plate may end
there. The object hides little of that."""
_LEAST_ELSEWHERE = 0.002
"""Smaller correlations at wrong heights are chance."""
_POINTS = 1600
"""Number of points of a ring"""
_LEAST_VIEWS, _LEAST_POINTS = 4, 40
"""A point counts if so many photos show it, and a photo if it shows so many points."""
_LEAST_DEVIATION = 2e-3
"""Tone-mapped standard deviation of a photo's details below which they are noise"""
_LARGEST = 3.0
"""Details larger than this many standard deviations count as this: they are edges of other things."""


@profiled("support plane")
def plane_by_details(photos: SmallPhotos, planes: list[Support]) -> Support | None:
    """The plane near one of `planes`, which differ in height alone, on whose details the photos agree. None without one."""
    details = photos.details(FINE)
    heights = np.array([plane.height for plane in planes])
    most, chosen = STANDS_OUT, None
    for width in _WIDTHS:
        found = np.array([correlation(details, _ring(plane, plane.radius, width)) for plane in planes])
        best = int(found.argmax())
        elsewhere = found[np.abs(heights - heights[best]) > APART]
        if found[best] < LEAST_CORRELATION or not 0 < best < len(planes) - 1 or not len(elsewhere):
            continue
        stands_out = found[best] / max(float(elsewhere.max()), _LEAST_ELSEWHERE)
        if stands_out >= most:
            most, chosen = stands_out, (planes[best], width)
    return None if chosen is None else _refined(details, *chosen)


def correlation(details: SmallPhotos, points: np.ndarray) -> float:
    """The mean correlation, -1..1, of what pairs of photos show at points [n, 3]; 0 where hardly any are seen.

    It is the mean over the three channels. A pattern may have one brightness everywhere.
    """
    shown = details.colors(torch.from_numpy(points.astype(np.float32)).to(details.photos.device))
    seen = torch.isfinite(shown[..., 0])
    counts = seen.sum(1) >= _LEAST_POINTS
    shown, seen = shown[counts], seen[counts]
    views = seen.sum(0)
    used = views >= _LEAST_VIEWS
    pairs = int((views * (views - 1))[used].sum())
    if not pairs:
        return 0.0
    standard = _standardized(shown, seen)[:, used]
    of_pairs = (standard.sum(0) ** 2 - (standard**2).sum(0)).sum(0)  # over pairs of different photos, each twice
    return float(of_pairs.mean() / pairs)


def _standardized(shown: Tensor, seen: Tensor) -> Tensor:
    """What photos show [views, n, 3], in standard deviations from the photo's mean; 0 where not `seen` [views, n] bool."""
    seen, count = seen[..., None], seen.sum(1)[:, None, None]
    apart = torch.where(seen, shown - torch.where(seen, shown, 0.0).sum(1, keepdim=True) / count, 0.0)
    deviation = ((apart**2).sum(1, keepdim=True) / count).sqrt().clamp_min(_LEAST_DEVIATION)
    return (apart / deviation).clamp(-_LARGEST, _LARGEST)


def _ring(plane: Support, inner: float, width: float) -> np.ndarray:
    """Points [n, 3] of the plane from the radius `inner` to `width` outside the object's sphere."""
    return ring(plane, inner, plane.radius + width - inner, _POINTS)


def _refined(details: SmallPhotos, start: Support, width: float) -> Support:
    """The plane near `start` with the largest correlation, by the method of Nelder and Mead in height, and then in tilt.

    The ring on which the photos are compared ends `width` outside the sphere. The tilt changes only if that helps clearly.
    """
    points = _ring(start, _INNER * start.radius, width)
    across, along = start.axes()
    lever = np.stack([np.ones(len(points)), points @ across, points @ along], 1)

    def moved(first: np.ndarray, steps: np.ndarray) -> tuple[np.ndarray, float]:
        def unlike(x: np.ndarray) -> float:
            return -correlation(details, points + (lever[:, : len(x)] @ x)[:, None] * start.normal)

        simplex = first + np.concatenate([np.zeros((1, len(steps))), np.diag(steps)])
        options = {"initial_simplex": simplex, "xatol": 2e-4, "fatol": 1e-5, "maxfev": 100}
        found = minimize(unlike, first, method="Nelder-Mead", options=options)
        return found.x, -float(found.fun)

    level, agreement = moved(np.zeros(1), np.array([0.01]))
    rise, tilted = moved(np.pad(level, (0, 2)), np.array([0.005, 0.01, 0.01]))
    if tilted < TILT_GAIN * agreement:
        rise = np.pad(level, (0, 2))
    normal = start.normal - rise[1] * across - rise[2] * along
    length = float(np.linalg.norm(normal))
    return Support(normal / length, (start.height + float(rise[0])) / length)
