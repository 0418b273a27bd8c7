"""How wide a pixel is, as an angle and at the object's distance."""

from __future__ import annotations

from blender_nep.capture.rays.pixel_rays import PixelRays

_PIXEL_WIDTH = 1.77
"""sqrt(pi): the width of a square divided by the radius of the disc with the same area."""
_FOOTPRINT_PIXELS = 1000


def pixel_width(half_angle):
    """Angle across a pixel [...] in radians, from the half angle of its cone (array or tensor [...], radians).

    The cone has the pixel's solid angle Omega. A camera's pixel is narrow, so that Omega = pi half_angle^2 for the cone and
    Omega = width^2 for the square pixel. Hence width = sqrt(pi) half_angle.
    """
    return _PIXEL_WIDTH * half_angle


def pixel_footprint(rays: PixelRays, most: int = _FOOTPRINT_PIXELS) -> float:
    """Median width of a pixel at the object's distance, unit frame, over about `most` pixels whose rays meet the sphere."""
    some = rays.sphere[:: max(1, len(rays.sphere) // most)]
    origin, _, half_angle = rays.rays(some)
    return float((pixel_width(half_angle) * origin.norm(dim=-1)).median())
