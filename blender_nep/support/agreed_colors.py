"""The colors of the support plane in the object's sphere, found where the photos agree on them.

F_e knows nothing of what lies in the object's sphere. So without these colors, a table looks like a part of the object in
every photo, and the visual hull gets a mound beside its foot. A point of the plane that photos see has one color in all of
them, up to gloss. A point that the object hides has the object's colors, which mostly differ from photo to photo, or another
chromaticity than the table beside the object.

A part of the photos does not count for a point: those in which the inner part of the shape that is known so far hides it.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from blender_nep.capture.rays.pixel_rays import PixelRays
from blender_nep.evidence.agreement import ALIKE, majority, spread
from blender_nep.evidence.observation import colors_of, observe
from blender_nep.evidence.occluders import SdfOccluder
from blender_nep.evidence.sdf_grid import SdfGrid, cell_centers
from blender_nep.evidence.small_photos import SmallPhotos
from blender_nep.profiling import profiled
from blender_nep.support.in_photos import LEAST_CONTRAST, REACH
from blender_nep.support.plane import Support, ring
from blender_nep.support.texture import PlaneTexture
from blender_nep.tone_mapping import inverse_tone_map

LEAST_SHARE = 0.4
"""A color is known if this share of the photos that count agree on it."""
LEAST_VIEWS = 6
"""And if at least this many photos count."""
CORE = 0.05
"""What lies deeper than this in the shape that is known so far hides the plane, in object radii. The rest may be a mound
that is not there."""
CHROMATICITY = 0.06
"""Largest difference between the chromaticity of a known color and that of the plane beside the object. An object of one
plain color would otherwise be taken for the plane that it hides."""
BRIGHTER = 1.5
"""A known color is at most so many times brighter than the plane beside the object. It may be darker: shadows."""
_SPREADS, _MOST_APART = 2.5, 0.12
"""Photos agree if they differ by less than this many times the usual spread of the plane's colors beside the object, at most
by _MOST_APART."""
_TEXELS = 84
"""Texels along each side of the texture, which spans the sphere."""
_BESIDE, _BESIDE_POINTS = 0.5, 400
"""Width of the ring beside the object's sphere in which sure colors are looked for, and number of its points."""
_SHARP_SHARE, _SHARP = 0.5, 0.6
"""A color inside the sphere is sharp if more than _SHARP_SHARE of the photos agree on it, and fewer by the factor _SHARP at
REACH above and below the plane."""
_LEAST_SURE = 20
"""Smallest number of points at which the plane's color is sure."""
_FIRST, _LAST, _STEPS = 0.03, 1.9, 48
"""Whether the shape hides a point is asked at so many distances, between these, on the way to the camera."""


class AgreedColors:
    """Finds the colors of the support plane in the object's sphere, with what is known of the object's shape."""

    @profiled("support texture")
    @torch.no_grad()
    def __init__(self, rays: PixelRays, support: Support) -> None:
        """Find colors that the plane surely has. Takes about a CPU second."""
        self._support, self._photos = support, SmallPhotos(rays)
        square = support.square(cell_centers(_TEXELS))
        self._points = torch.from_numpy(square.astype(np.float32)).to(rays.radiance.device)
        self._inside = self._points.norm(dim=-1) < 1
        self._apart = _most_apart(self._photos, support)
        self._sure = _surely_plane(self._photos, support, self._points[self._inside], self._apart)

    @profiled("support texture")
    @torch.no_grad()
    def texture(self, sdf: np.ndarray) -> PlaneTexture:
        """The colors on which the photos agree. Takes about a CPU second.

        sdf [n, n, n]: the object's shape as it is known so far, at the centers of n^3 cells of [-1, 1]^3, negative inside.
        """
        points = self._points[self._inside]
        colors = colors_of(observe(self._photos, points, occluder=core_of(sdf)), len(points))
        found, share, count = majority(colors, self._apart)
        found = inverse_tone_map(found)
        color, known = torch.zeros_like(self._points), torch.zeros_like(self._inside)
        color[self._inside] = found
        known[self._inside] = (share > LEAST_SHARE) & (count >= LEAST_VIEWS) & _like_the_plane(found, self._sure)
        return PlaneTexture(self._support, 1.0, color, known)


def core_of(sdf: np.ndarray) -> SdfOccluder:
    """The inner part of a shape with the SDF [n, n, n] in the cells of [-1, 1]^3, which hides points of a plane under it."""
    return SdfOccluder(SdfGrid(sdf), level=-CORE, first=_FIRST, last=_LAST, steps=_STEPS)


def _most_apart(photos: SmallPhotos, support: Support) -> float:
    """How much two photos that agree on a color of the plane may differ: the usual `ALIKE`, or more where photos differ.

    Photos differ by noise, by exposures that are not known exactly, and by the photographer's shadow. How much, the plane
    beside the object tells. It counts if the plane stands out there.
    """
    points = _ring_beside(support).to(photos.photos.device)
    rise = _rise(support, points)
    here, below, above = (float(spread(photos.colors(at)).nanmedian()) for at in (points, points - rise, points + rise))
    stands_out = below > LEAST_CONTRAST * here and above > LEAST_CONTRAST * here  # False where photos do not show the ring
    if not stands_out:
        return ALIKE
    return min(max(_SPREADS * here, ALIKE), _MOST_APART)


def _ring_beside(support: Support) -> Tensor:
    """Points [_BESIDE_POINTS, 3] of the plane beside the object's sphere."""
    return torch.from_numpy(ring(support, support.radius, _BESIDE, _BESIDE_POINTS).astype(np.float32))


def _rise(support: Support, like: Tensor) -> Tensor:
    """The way [3] from the plane to what lies REACH above it."""
    return REACH * torch.as_tensor(np.asarray(support.normal), dtype=like.dtype, device=like.device)


def _surely_plane(photos: SmallPhotos, support: Support, inside: Tensor, apart: float) -> Tensor:
    """Colors [m, 3] that the plane surely has: those beside the sphere, and the sharp ones among points [n, 3] inside.

    A color is sharp if clearly fewer photos agree on it REACH above and below the plane. That of a plain object is not.
    """
    color, share, count = majority(photos.colors(_ring_beside(support).to(inside.device)), apart)
    beside = color[(share > LEAST_SHARE) & (count >= LEAST_VIEWS)]
    rise = _rise(support, inside)
    color, share, count = majority(photos.colors(inside), apart)
    elsewhere = torch.maximum(*(majority(photos.colors(moved), apart).share for moved in (inside - rise, inside + rise)))
    sharp = (share > _SHARP_SHARE) & (elsewhere < _SHARP * share) & (count >= LEAST_VIEWS)
    return inverse_tone_map(torch.cat([beside, color[sharp]]))


def _like_the_plane(color: Tensor, sure: Tensor) -> Tensor:
    """Whether colors [n, 3] may be colors of a plane that surely has the colors [m, 3]: [n] bool."""
    if len(sure) < _LEAST_SURE:
        return torch.zeros(len(color), dtype=torch.bool, device=color.device)
    hue, brightness = _chromaticity(color)
    hues, brightnesses = _chromaticity(sure)
    alike = (hue[:, None] - hues).abs().amax(-1) < CHROMATICITY
    return (alike & (brightness[:, None] < BRIGHTER * brightnesses)).any(1)


def _chromaticity(color: Tensor) -> tuple[Tensor, Tensor]:
    """Chromaticity [n, 3] and sum of the channels [n] of linear colors [n, 3]."""
    brightness = color.sum(-1)
    return color / brightness.clamp_min(1e-6)[:, None], brightness
