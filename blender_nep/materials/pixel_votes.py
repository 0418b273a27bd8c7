"""Finds how well each material fits the label pixels, for which no light was gathered.

Light hardly changes between neighbouring pixels of one photo. So the radiance that a pixel would have with each material is
taken from the nearest samples of the same photo, whose light is known. It is compared with the pixel's own radiance. Whether
the light really changes that little is measured: each sample is predicted from its neighbours, too (`left_out_error`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from blender_nep.materials.baking import kernel, neighbours, weighted_mean

_NEAREST = 4
_BEND = 0.2
"""Distance on the surface, in the unit frame, that counts as much as a turn of the normal by one radian."""


class Surfels(NamedTuple):
    """The n surface points that some pixels see."""

    position: np.ndarray
    """[n, 3] unit frame"""
    normal: np.ndarray
    """[n, 3] unit vectors"""
    photo: np.ndarray
    """[n] int, index of the photo"""

    def features(self) -> np.ndarray:
        """Coordinates [n, 6] of position and normal. Points that are near in these coordinates have similar light."""
        return np.concatenate([self.position, _BEND * self.normal], 1)


def pixel_costs(samples: Surfels, shown: np.ndarray, pixels: Surfels, goal: np.ndarray, clip: float) -> np.ndarray:
    """Residual [m, K] of every pixel under each material: mean over the channels, at most `clip`.

    shown [n, K, 3] is the radiance that each sample would have with each material; goal [m, 3] is the radiance of the
    pixels. Both are tone-mapped. In a photo without samples, the residual of every material is `clip`.
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


def nearest_samples(samples: Surfels, pixels: Surfels) -> tuple[np.ndarray, np.ndarray]:
    """Indices [m, S] int64 and weights [m, S] float32 of the samples of the same photo whose light is that of each pixel.

    The weights of a pixel add up to 1; they are 0 in a photo without samples.
    """
    index, share = np.zeros((len(pixels.photo), _NEAREST), np.int64), np.zeros((len(pixels.photo), _NEAREST), np.float32)
    known, asked = samples.features(), pixels.features()
    for photo in np.unique(samples.photo):
        here, there = np.flatnonzero(samples.photo == photo), np.flatnonzero(pixels.photo == photo)
        if len(there) == 0:
            continue
        distance, near = neighbours(cKDTree(known[here]), asked[there], _NEAREST)
        weight = kernel(distance)
        index[there, : near.shape[1]] = here[near]
        share[there, : near.shape[1]] = weight / weight.sum(1, keepdims=True)
    return index, share


def left_out_error(samples: Surfels, shown: np.ndarray) -> np.ndarray:
    """Error [n, K] of predicting each sample from the nearest other samples of its photo, mean over the channels.

    shown [n, K, 3] is the tone-mapped radiance that each sample would have with each material. The error is 1 where the
    photo has no other sample.
    """
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
