"""Finds which way is up from the cameras: people and tripods hold cameras upright."""

from __future__ import annotations

import numpy as np

CLEAR, LEAST_TURNED = 4.0, 0.01
"""Photos that are turned about the upward direction tell it clearly if the second smallest mean square of their horizontal
axes is `CLEAR` times the smallest, and at least `LEAST_TURNED` (6 degrees): photos are rolled by a few degrees by chance."""


def upward(right: np.ndarray, above: np.ndarray) -> np.ndarray:
    """The upward direction [3] of cameras whose image axes are `right` [n, 3] and `above` [n, 3], unit vectors in one frame.

    The horizontal axes of upright photos are horizontal, so the upward direction is the one that is most nearly orthogonal
    to all of them. The mean of the cameras' own upward axes gives its sign. That mean alone serves where all cameras look
    along one line.
    """
    mean = above.mean(0)
    spread, directions = np.linalg.eigh(right.T @ right / len(right))
    up = directions[:, 0] if spread[1] > max(CLEAR * spread[0], LEAST_TURNED) else mean
    up = up * (np.sign(up @ mean) or 1.0)
    return up / max(float(np.linalg.norm(up)), 1e-12)
