"""Finds how well each material fits the label pixels, for which no light was gathered.

Light hardly changes between neighboring pixels of one photo. So the radiance that a pixel would have with each material is
taken from the nearest samples of the same photo, whose light is known. It is compared with the pixel's own radiance. Whether
the light really changes that little is measured: each sample is predicted from its neighbors, too (`left_out_error`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from blender_nep.materials.baking import kernel, neighbors

_NEAREST = 4
_BLOCK = 1 << 14
"""Pixels whose neighbors' radiances are read at a time. This bounds the memory."""
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


def nearest_samples(samples: Surfels, pixels: Surfels, first: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Indices [m, S] int64 and weights [m, S] float32 of the samples of the same photo whose light is that of each pixel.

    The weights of a pixel add up to 1, or are 0 where the photo has no sample. The neighbors begin with number `first`: for
    pixels that are samples themselves, number 0 is the sample itself.
    """
    index, share = np.zeros((len(pixels.photo), _NEAREST), np.int64), np.zeros((len(pixels.photo), _NEAREST), np.float32)
    known, asked = samples.features(), pixels.features()
    for photo in np.unique(samples.photo):
        here, there = np.flatnonzero(samples.photo == photo), np.flatnonzero(pixels.photo == photo)
        if len(there) == 0 or len(here) <= first:
            continue
        distance, near = (a[:, first:] for a in neighbors(cKDTree(known[here]), asked[there], _NEAREST + first))
        weight = kernel(distance)
        index[there, : near.shape[1]] = here[near]
        share[there, : near.shape[1]] = weight / weight.sum(1, keepdims=True)
    return index, share


def pixel_costs(samples: Surfels, shown: np.ndarray, pixels: Surfels, goal: np.ndarray, clip: float) -> np.ndarray:
    """Residual [m, K] of every pixel under each material: mean over the channels, at most `clip`.

    shown [n, K, 3] is the radiance that each sample would have with each material; goal [m, 3] is the radiance of the
    pixels. Both are tone-mapped. In a photo without samples, the residual of every material is `clip`.
    """
    return _residuals(shown, nearest_samples(samples, pixels), goal[:, None], clip).clip(max=clip)


def left_out_error(samples: Surfels, shown: np.ndarray) -> np.ndarray:
    """Error [n, K] of predicting each sample from the nearest other samples of its photo, mean over the channels.

    shown [n, K, 3] is the tone-mapped radiance that each sample would have with each material. The error is 1 where the
    photo has no other sample.
    """
    return _residuals(shown, nearest_samples(samples, samples, first=1), shown, 1.0)


def _residuals(shown: np.ndarray, near: tuple[np.ndarray, np.ndarray], goal: np.ndarray, unknown: float) -> np.ndarray:
    """Mean absolute difference [m, K] over the channels of goal [m, 1 or K, 3] and of what the nearest samples show.

    shown [n, K, 3] is that of the samples; near: `nearest_samples`. It is `unknown` where there are none.
    """
    index, share = near
    out = np.full((len(index), shown.shape[1]), unknown, np.float32)
    known = np.flatnonzero(share.any(1))
    for start in range(0, len(known), _BLOCK):
        rows = known[start : start + _BLOCK]
        expected = np.einsum("ms,mskc->mkc", share[rows], shown[index[rows]])
        out[rows] = np.abs(expected - goal[rows]).mean(-1)
    return out
