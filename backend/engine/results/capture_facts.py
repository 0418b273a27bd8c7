"""Puts what the engine knows of a capture (`blender_nep info --json`) into the panel's words. No bpy in this file."""

from collections.abc import Mapping
from typing import Any

from ..words import EngineMessage, Translate

PHOTOS = "{photos} photos of {size} pixels"
PHOTOS_OF_SIZES = "{photos} photos of {sizes} sizes"
COVERAGE = "{percent:.0f} % of all directions are near a photo"
SPHERE = "The object's sphere is about {pixels:.0f} pixels wide in the photos"
EXPOSURE_UNKNOWN = "Exposure: not known"
EXPOSURE_EQUAL = "Exposure: no clear difference between the photos"
EXPOSURE_DIFFERS = "Exposure: up to {stops:.1f} stops apart, which is evened out"

DISCS_ROWS = (0.09, 0.86)
"""From which to which part of its height the picture of the photos' directions shows the discs, between title and legend"""


def texts() -> list[str]:
    """All texts of this file that a translator translates."""
    exposure = (EXPOSURE_UNKNOWN, EXPOSURE_EQUAL, EXPOSURE_DIFFERS)
    return [PHOTOS, PHOTOS_OF_SIZES, COVERAGE, SPHERE, *exposure]


def warnings_of(found: Mapping[str, Any]) -> list[EngineMessage]:
    """What looks wrong with the capture."""
    return [EngineMessage.of(told) for told in found.get("warnings") or ()]


def facts_of(found: Mapping[str, Any], translate: Translate = str) -> list[str]:
    """The main facts, a line each. A fact that an older engine does not tell is left out."""
    lines, sizes = [], found.get("sizes") or {}
    if len(sizes) == 1:
        lines.append(translate(PHOTOS).format(photos=found.get("photos"), size=next(iter(sizes))))
    elif sizes:
        lines.append(translate(PHOTOS_OF_SIZES).format(photos=found.get("photos"), sizes=len(sizes)))
    if "directions_covered" in found:
        lines.append(translate(COVERAGE).format(percent=100 * found["directions_covered"]))
    hole = found.get("largest_hole")
    if hole and hole not in (found.get("warnings") or ()):  # a large hole is told with the warnings
        lines.append(EngineMessage.of(hole).words(translate))
    if "sphere_width" in found:
        lines.append(translate(SPHERE).format(pixels=found["sphere_width"]))
    if "exposure_stops" in found:
        stops = found["exposure_stops"]
        text = EXPOSURE_UNKNOWN if stops is None else EXPOSURE_DIFFERS if stops else EXPOSURE_EQUAL
        lines.append(translate(text).format(stops=stops))
    return lines
