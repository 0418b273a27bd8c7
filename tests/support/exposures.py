"""Exposures by the surroundings alone."""

from blender_nep.capture.exposure.surroundings import Exposures, compare_exposures
from blender_nep.capture.rays.pixel_rays import PixelRays


def find_exposures(rays: PixelRays) -> Exposures:
    """What the surroundings tell of the photos' exposures; nothing if the photos share too little of them."""
    compared = compare_exposures(rays)
    return Exposures(None) if compared is None else compared.exposures(rays.radiance.device)
