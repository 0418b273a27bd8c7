"""Which material every pixel votes for, not only those that the light was gathered for.

Light hardly changes between neighbouring pixels of one photo. So what a pixel would show of each material is taken from the
nearest samples of the same photo, whose light is known, and compared with what it does show. Whether it is so is measured:
each sample is predicted by its neighbours, too.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from blender_nep.materials.baking import neighbours, weighted_mean

_NEAREST = 4
_BEND = 0.2
"""Distance on the surface, unit frame, that counts as much as a turn of the normal by a radian."""


class Surfels(NamedTuple):
    """Where pixels see the surface."""

    position: np.ndarray
    """[n,3] unit frame"""
    normal: np.ndarray
    """[n,3]"""
    photo: np.ndarray
    """[n] int"""

    def features(self) -> np.ndarray:
        """[n,6]: what is near in them is lit alike."""
        return np.concatenate([self.position, _BEND * self.normal], 1)


def pixel_costs(samples: Surfels, shown: np.ndarray, pixels: Surfels, goal: np.ndarray, clip: float) -> np.ndarray:
    """Residual [m,K] of every pixel under each material: mean over the channels, at most `clip`.

    shown [n,K,3]: what each sample would show of each material; goal [m,3]: what the pixels show; both tone-mapped. A pixel
    of a photo without samples costs `clip` whatever it is made of.
    """
    cost = np.full((len(goal), shown.shape[1]), clip, np.float32)
    known, asked = samples.features(), pixels.features()
    for photo in np.unique(samples.photo):
        here, there = np.flatnonzero(samples.photo == photo), np.flatnonzero(pixels.photo == photo)
        if len(there) == 0:
            continue
        distance, index = neighbours(cKDTree(known[here]), asked[there], _NEAREST)
        expected = _expected(shown[here], distance, index)
        cost[there] = np.abs(expected - goal[there, None]).mean(-1).clip(max=clip)
    return cost


def left_out_error(samples: Surfels, shown: np.ndarray) -> np.ndarray:
    """Mean error [n,K] over the channels of what the nearest other samples of its photo say that a sample would show of each
    material [n,K,3]; 1 where there are none."""
    error, features = np.ones(shown.shape[:2], np.float32), samples.features()
    for photo in np.unique(samples.photo):
        here = np.flatnonzero(samples.photo == photo)
        if len(here) == 1:
            continue
        distance, index = (a[:, 1:] for a in neighbours(cKDTree(features[here]), features[here], _NEAREST + 1))
        error[here] = np.abs(_expected(shown[here], distance, index) - shown[here]).mean(-1)
    return error


def _expected(shown: np.ndarray, distance: np.ndarray, index: np.ndarray) -> np.ndarray:
    n, materials, _ = shown.shape
    return weighted_mean(shown.reshape(n, -1), distance, index).reshape(len(index), materials, 3)
