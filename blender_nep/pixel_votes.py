"""Which material every pixel votes for, not only those that the light was gathered for.

Light hardly changes between neighbouring pixels of one photo. So what a pixel would show of each material is taken from the
nearest samples of the same photo, whose light is known, and compared with what it does show.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from blender_nep.material_textures import kernel, neighbours

_NEAREST = 4
_BEND = 0.2
"""Distance on the surface, unit frame, that counts as much as a turn of the normal by a radian."""


def pixel_costs(samples: tuple[np.ndarray, np.ndarray, np.ndarray], shown: np.ndarray,
                pixels: tuple[np.ndarray, np.ndarray, np.ndarray], goal: np.ndarray, clip: float) -> np.ndarray:
    """Residual [m,K] of every pixel under each material: mean over the channels, at most `clip`.

    samples, pixels: position [n,3] (unit frame), normal [n,3], photo [n] int of either; shown [n,K,3]: what each sample
    would show of each material; goal [m,3]: what the pixels show; both tone-mapped. A pixel of a photo without samples costs
    `clip` whatever it is made of.
    """
    features = [np.concatenate([position, _BEND * normal], 1) for position, normal, _ in (samples, pixels)]
    cost = np.full((len(goal), shown.shape[1]), clip, np.float32)
    for photo in np.unique(samples[2]):
        here, there = np.flatnonzero(samples[2] == photo), np.flatnonzero(pixels[2] == photo)
        if len(there) == 0:
            continue
        distance, index = neighbours(cKDTree(features[0][here]), features[1][there], _NEAREST)
        weight = kernel(distance)
        weight /= weight.sum(1, keepdims=True)
        expected = np.einsum("ij,ijkc->ikc", weight, shown[here][index])
        cost[there] = np.abs(expected - goal[there, None]).mean(-1).clip(max=clip)
    return cost
