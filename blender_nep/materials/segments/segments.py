"""Segments: groups of surface points that lie near each other and have one color.

The color of a point is the median of the photos that show it. Few photos show a highlight, so the median leaves it out.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from scipy.cluster.vq import kmeans2
from scipy.spatial import cKDTree

from blender_nep.materials.baking import neighbors
from blender_nep.profiling import profiled

_PLACE = 0.09
"""Distance on the surface, in object radii, that separates two points as much as one of the following differences."""
_HUE = 0.08
"""Difference of the logarithms of the channels, without their mean."""
_BRIGHTNESS = 0.25
"""Difference of the mean logarithm. It is larger than that of the hue, because shading changes brightness."""
_BLACK = 0.01
"""Radiance that is added before a logarithm is taken, so that noise in the dark does not count."""
_ITERATIONS = 8
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


def features(position: np.ndarray, color: np.ndarray) -> np.ndarray:
    """Coordinates [n, 7] in which points of one segment are near: position [n, 3], unit frame, and log color [n, 3]."""
    return np.concatenate([position / _PLACE, features_of_color(color)], 1)


def features_of_color(color: np.ndarray) -> np.ndarray:
    """Coordinates [n, 4] in which log colors [n, 3] of one segment are near."""
    brightness = color.mean(1, keepdims=True)
    return np.concatenate([(color - brightness) / _HUE, brightness / _BRIGHTNESS], 1)


@dataclass
class Segments:
    """K segments of n points."""

    center: np.ndarray
    """[K, 7] mean `features` of the points of each segment"""
    label: np.ndarray
    """[n] int, the segment of each point"""

    @classmethod
    @profiled("segments")
    def of(cls, position: np.ndarray, color: np.ndarray, count: int, seed: int) -> Segments:
        """At most `count` segments, by k-means in the coordinates `features`. No segment is empty."""
        points = features(position, color)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of empty clusters, which are left out below
            random = np.random.default_rng(seed)  # the seed itself may be too large for SciPy
            center, _ = kmeans2(points, min(count, len(points)), _ITERATIONS, minit="points", seed=random)
        used, label = np.unique(cKDTree(center).query(points)[1], return_inverse=True)
        return cls(center[used], label.ravel())

    def __len__(self) -> int:
        return len(self.center)

    def near(self, points: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Distances and indices [m, count] of the segments that are nearest to points of coordinates [m, 7]."""
        return neighbors(cKDTree(self.center), points, count)
