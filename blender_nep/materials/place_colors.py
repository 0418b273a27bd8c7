"""The color of places of the surface: the median of the photos that show it. Few photos show a highlight: it is left out."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from blender_nep.materials.baking import neighbors
from blender_nep.profiling import profiled

_HUE = 0.08
"""Difference of the logarithms of the channels, without their mean."""
_BRIGHTNESS = 0.25
"""Difference of the mean logarithm. It is larger than that of the hue, because shading changes brightness."""
_BLACK = 0.01
"""Radiance that is added before a logarithm is taken, so that noise in the dark does not count."""
_BLOCK = 1 << 16
"""Points whose medians are computed at a time. This bounds the memory."""


@profiled("colors of places")
def median_color(tree: cKDTree, radiance: np.ndarray, at: np.ndarray, count: int) -> np.ndarray:
    """Median log radiance [m, 3] of the `count` nearest pixels around each point `at` [m, 3].

    `tree` holds the positions of n pixels of all photos, unit frame; radiance [n, 3] is theirs, linear.
    """
    value = np.log(radiance + _BLACK)
    out = np.empty((len(at), 3), np.float32)
    for start in range(0, len(at), _BLOCK):
        part = slice(start, start + _BLOCK)
        out[part] = np.median(value[neighbors(tree, at[part], count)[1]], 1)
    return out


def features_of_color(color: np.ndarray) -> np.ndarray:
    """Coordinates [n, 4] in which log colors [n, 3] of one segment are near."""
    brightness = color.mean(1, keepdims=True)
    return np.concatenate([(color - brightness) / _HUE, brightness / _BRIGHTNESS], 1)
