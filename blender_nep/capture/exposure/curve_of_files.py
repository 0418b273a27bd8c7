"""Finds the camera's response curve where EXIF tells that photos were exposed differently.

Photos of different exposure show the same surroundings on different parts of the curve. Without the curve, they differ by
the ratio of their exposures. So the curve is the one with which EXIF's exposures explain the differences between the photos
nearly as well as free gains do. It must be undone before the exposures are evened out.
"""

from __future__ import annotations

import numpy as np

from blender_nep.capture.exposure.from_exif import LEAST_AGREEMENT, agreement
from blender_nep.capture.exposure.surroundings import LEAST_SPREAD, Comparison, compare_exposures
from blender_nep.capture.rays.pixel_rays import PixelRays
from blender_nep.capture.rays.response_curve import MOST_STRENGTH, ResponseCurve
from blender_nep.capture.rays.tried_strengths import TriedStrengths
from blender_nep.profiling import profiled

_STRENGTHS = tuple(np.linspace(0, MOST_STRENGTH, 5).tolist())
"""Strengths that are tried"""


@profiled("response curve")
def curve_of_files(
    rays: PixelRays,
    compared: Comparison,
    gains: np.ndarray | None,
    session: np.ndarray,
    expected: float | None,
    prior: float,
) -> ResponseCurve | None:
    """The response curve in the files' values; that of strength 0 is sRGB alone.

    None: the exposures tell nothing of it, or the surroundings deny them (`exposures_from_exif`).
    compared: the exposures as the files have them. gains [views] are `exif_gains` and session [views] is that of `sessions`.
    `expected` is the strength that the files make likely (None: values are linear); the cost of another one is `prior` times
    the square of the difference.
    """
    if gains is None or expected is None:
        return None
    log = np.log(gains)
    middle = np.array([log[session == number].mean() for number in range(session.max() + 1)])
    if float((log - middle[session]).std()) < LEAST_SPREAD:
        return None
    errors = [_error(compared, gains, session)]  # strength 0
    for strength in _STRENGTHS[1:]:
        without_curve = compare_exposures(rays.with_curve_of_files(ResponseCurve.of_files(strength)))
        if without_curve is None:
            return None
        errors.append(_error(without_curve, gains, session))
    if min(errors) > 1 / LEAST_AGREEMENT:  # EXIF does not count for the exposures then, and not for the curve either
        return None
    return ResponseCurve.of_files(TriedStrengths(_STRENGTHS, tuple(errors)).best(expected, prior))


def _error(compared: Comparison, gains: np.ndarray, session: np.ndarray) -> float:
    """How much the surroundings differ with EXIF's exposures, as a multiple of how much with the gains that fit best."""
    return 1 / max(agreement(gains, session, compared), 1e-6)
