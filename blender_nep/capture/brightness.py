"""How bright the photos of a capture are.

Losses compare tone-mapped radiance. The tone mapping is nearly linear in dark photos, so the same relative error counts less
there, and the priors, whose weights are fixed, count more. So all captures are brought to about the same brightness. Where
the object is much darker than its surroundings, as bronze before a white wall, photos and surroundings together are made
brighter, so that the object is not too dark.
"""

from __future__ import annotations

import torch
from torch import Tensor

from blender_nep.capture.rays.pixel_rays import PixelRays

MOST_EXPOSURE = 1024.0
"""Largest exposure, and the inverse of the smallest one."""
DARKEST_OBJECT = 0.5
"""The object gets at least this many times the brightness that is wanted of all pixels. Beside all that sees its sphere,
rendered objects and a gilt cape are 0.6 to 1.8 times as bright, a brass blowtorch and a head of bronze 0.3 times
(docs/lab/brightness.md)."""
MOST_BRIGHTENED = 4.0
"""Largest factor by which a dark object makes the photos brighter. In a trial, the head was worse with 6 than with 3."""
_NEAR = 0.25
"""Without masks, rays that pass the sphere's center at most so far away, in its radii, are taken for the object's."""


def typical_radiance(rays: PixelRays, pixels: int = 10_000) -> float:
    """Geometric mean radiance, over all channels, of about `pixels` of the pixels that see the object's sphere.

    Pixels that are much darker than the others, such as the black around a cut-out object, do not count. 1 if all are black.
    """
    return _typical(rays, _some_in_sphere(rays, pixels)) or 1.0


def radiance_of_object(rays: PixelRays, pixels: int = 10_000) -> float | None:
    """As `typical_radiance`, of the object alone: of its masks, or of what is seen near the sphere's center.

    None: no such pixel is there, or all are black.
    """
    index = _some_in_sphere(rays, pixels)
    if rays.mask is not None:
        own = rays.mask[index] > 127
    else:
        bundle = rays.rays(index)
        own = torch.linalg.cross(bundle.origins, bundle.directions).norm(dim=-1) < _NEAR
    return _typical(rays, index[own])


def _some_in_sphere(rays: PixelRays, pixels: int) -> Tensor:
    """About `pixels` of the pixels that see the object's sphere, evenly spread: their indices [n]."""
    return rays.sphere[:: max(1, len(rays.sphere) // pixels)]


def _typical(rays: PixelRays, index: Tensor) -> float | None:
    """The geometric mean of the pixels index [n] that are not much darker than the others; None if all are black."""
    radiance = rays.photo(index)
    brightness = radiance.mean(-1)
    if not len(index) or float(brightness.max()) <= 0:
        return None
    lit = brightness > 0.01 * brightness.quantile(0.9)
    return float(radiance[lit].clamp(min=1e-6).log().mean().exp()) if lit.any() else None


def to_brightness(rays: PixelRays, brightness: float) -> PixelRays:
    """The same pixels, with the exposure that makes their typical radiance equal to `brightness`.

    The exposure is longer, by at most MOST_BRIGHTENED, where the object would be darker than DARKEST_OBJECT times
    `brightness`.
    """
    typical, of_object = typical_radiance(rays), radiance_of_object(rays)
    darker = 1.0 if of_object is None else DARKEST_OBJECT * typical / of_object
    exposure = rays.exposure * brightness / typical * min(max(darker, 1.0), MOST_BRIGHTENED)
    return rays.with_exposure(min(max(exposure, 1 / MOST_EXPOSURE), MOST_EXPOSURE))
