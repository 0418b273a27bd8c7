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
from blender_nep.materials.place_colors import features_of_color
from blender_nep.profiling import profiled

_PLACE = 0.09
"""Distance on the surface, in object radii, that separates two points as much as one of the following differences."""
_ITERATIONS = 8


def features(position: np.ndarray, color: np.ndarray) -> np.ndarray:
    """Coordinates [n, 7] in which points of one segment are near: position [n, 3], unit frame, and log color [n, 3]."""
    return np.concatenate([position / _PLACE, features_of_color(color)], 1)


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
