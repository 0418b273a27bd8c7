"""The place at which cameras look together."""

from __future__ import annotations

import numpy as np

_MOST_CONDITION = 1e6


def common_place(position: np.ndarray, axis: np.ndarray) -> np.ndarray | None:
    """The point [3] nearest to all optical axes; None where they are parallel.

    position [n, 3] and axis [n, 3], unit vectors: the cameras. The point is found by least squares on the distances from the
    axes, reweighted five times towards the point of least absolute distances.
    """
    across = np.eye(3) - axis[:, :, None] * axis[:, None, :]
    weight = np.ones(len(position))
    for _ in range(5):
        a = (weight[:, None, None] * across).sum(0)
        if np.linalg.cond(a) > _MOST_CONDITION:
            return None
        center = np.linalg.solve(a, (weight[:, None] * np.einsum("nij,nj->ni", across, position)).sum(0))
        offset = np.linalg.norm(np.einsum("nij,nj->ni", across, center - position), axis=1)
        weight = 1.0 / np.maximum(offset, 1e-3 * np.linalg.norm(position - center, axis=1).mean() + 1e-12)
    return center
