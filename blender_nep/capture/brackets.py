"""Finds photos that were taken as brackets: several exposures of each view, to be merged to one with a large range (HDR)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from blender_nep.capture.photos.exif_exposure import exif_exposure
from blender_nep.messages import Message

_SIZES = (3, 5, 7, 9, 2)
"""So many exposures cameras take of a view"""
_LEAST_STOPS = 0.9
"""Exposures of a bracket differ by more, from the darkest to the brightest"""
_SAME_STOPS = 0.25
"""The steps of all brackets are alike up to this."""
_LEAST_SHARE = 0.8
"""Brackets may be incomplete: so many of them must have the steps of the first one"""
_LEAST_BRACKETS = 2


def bracket_warnings(photos: Sequence[Path]) -> list[Message]:
    """The warning about photos in brackets; none where EXIF tells no exposures. `photos` may have any order."""
    if len(photos) < 2 * _LEAST_BRACKETS:
        return []
    known = []
    for photo in sorted(photos):
        stop = _stops(photo)
        if stop is None:  # the others need not be asked
            return []
        known.append(stop)
    for size in _SIZES:
        groups = [known[start : start + size] for start in range(0, len(known) - size + 1, size)]
        if len(groups) < _LEAST_BRACKETS or len(known) % size:
            continue
        steps = [[stop - group[0] for stop in group] for group in groups]
        spread = max(steps[0]) - min(steps[0])
        alike = sum(all(abs(a - b) < _SAME_STOPS for a, b in zip(one, steps[0], strict=True)) for one in steps)
        distinct = all(abs(a - b) > _SAME_STOPS for n, a in enumerate(steps[0]) for b in steps[0][:n])
        if spread > _LEAST_STOPS and distinct and alike >= _LEAST_SHARE * len(groups):
            return [Message("capture.brackets", {"size": size, "photos": len(known), "stops": spread})]
    return []


def _stops(photo: Path) -> float | None:
    """The exposure in stops, as EXIF tells it: by time, aperture and ISO; None where it does not tell the time."""
    seconds, f_number, iso = exif_exposure(photo)
    if seconds is None:
        return None
    return math.log2(seconds) - 2 * math.log2(f_number or 1.0) + math.log2(iso or 100.0)
