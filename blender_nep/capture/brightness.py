"""How bright the photos of a capture are.

Losses compare tone-mapped radiance. The tone mapping is nearly linear in dark photos, so the same relative error counts less
there, and the priors, whose weights are fixed, count more. So all captures are brought to about the same brightness.
"""

from __future__ import annotations

from blender_nep.capture.rays.pixel_rays import PixelRays

MOST_EXPOSURE = 1024.0
"""Largest exposure, and the inverse of the smallest one."""


def typical_radiance(rays: PixelRays, of_object: bool = False, pixels: int = 10_000) -> float:
    """Geometric mean radiance, over all channels, of about `pixels` of the pixels that see the object's sphere.

    of_object: of the object pixels, if there are masks. Pixels that are much darker than the others, such as the black
    around a cut-out object, do not count. 1 if all are black.
    """
    index = rays.sphere[:: max(1, len(rays.sphere) // pixels)]
    if of_object and rays.mask is not None and (rays.mask[index] > 127).any():
        index = index[rays.mask[index] > 127]
    radiance = rays.photo(index)
    brightness = radiance.mean(-1)
    lit = brightness > 0.01 * brightness.quantile(0.9)
    return float(radiance[lit].clamp(min=1e-6).log().mean().exp()) if lit.any() else 1.0


def to_brightness(rays: PixelRays, brightness: float) -> PixelRays:
    """The same pixels, with the exposure that makes their typical radiance equal to `brightness`."""
    exposure = rays.exposure * brightness / typical_radiance(rays)
    return rays.with_exposure(min(max(exposure, 1 / MOST_EXPOSURE), MOST_EXPOSURE))
