"""The rows of photos of a turntable: in each, the camera stood still at one place while the object turned."""

from __future__ import annotations

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage

from blender_nep.capture.turntable.axis import Axis, find_axis

LEAST_PHOTOS = 3
"""A camera that took fewer photos was held by hand, or moved."""
SAME_PLACE = 0.035
"""Two photos are of one row if the axis lies alike in both: its direction, in radians, and its place and height, as a share
of the camera's distance. Cameras that structure from motion finds are ten times as exact."""
STILL, MOST_AWAY = 0.02, 0.05
"""The camera of a row stood still if half of the row's photos differ by less than the first number from their median, in
the same measure. A photo that differs by more than the second number is left out. Measured for the half: 0.013 to 0.018
where the table wobbled by 0.01 radians, 0.023 to 0.026 for walks that kept distance, height and aim within 1 %."""


def find_rows(poses: np.ndarray, center: np.ndarray) -> np.ndarray | None:
    """The row [n] of each photo from 0 on, in the order of the photos, and -1 for a photo of no row; None without a row.

    `poses` [n, 4, 4]: camera-to-object. `center` [3]: of the object; it only says how far the cameras are.
    """
    axis = find_axis(poses)
    if axis is None:
        return None
    distance = float(np.median(np.linalg.norm(poses[:, :3, 3] - center, axis=1)))
    rows = _clusters(_tilt_and_height(axis, poses, distance))
    axis = find_axis(poses, rows)
    if axis is None:
        return None
    place = axis.in_cameras(poses)[:, 3:] / distance
    rows = _clusters(np.concatenate([_tilt_and_height(axis, poses, distance), place], 1))
    return rows if (rows >= 0).any() else None


def spread(axis: Axis, poses: np.ndarray) -> float:
    """How far the camera of one row moved: the largest deviation from the row's median, as in `SAME_PLACE`.

    `poses` [n, 4, 4]: camera-to-object, of photos of one row.
    """
    seen = axis.in_cameras(poses)
    distance = max(float(np.median(np.linalg.norm(seen[:, 3:], axis=1))), 1e-9)
    height = axis.height(poses[:, :3, 3])[:, None]
    values = np.concatenate([seen[:, :3], seen[:, 3:] / distance, height / distance], 1)
    return float(np.linalg.norm(values - np.median(values, axis=0), axis=1).max())


def _tilt_and_height(axis: Axis, poses: np.ndarray, distance: float) -> np.ndarray:
    return np.concatenate([axis.in_cameras(poses)[:, :3], axis.height(poses[:, :3, 3])[:, None] / distance], 1)


def _clusters(values: np.ndarray) -> np.ndarray:
    """Clusters [n] of values [n, k] by single linkage, numbered by their first member; -1 in those that are too small.

    Single linkage chains the photos of a walk, each of which is near the next one. So only members near the cluster's median
    stay, and none where most are not near. Complete linkage would split the row of a table that wobbles.
    """
    if len(values) < LEAST_PHOTOS:
        return np.full(len(values), -1)
    found = fcluster(linkage(values, "single"), SAME_PLACE, "distance")
    rows, number = np.full(len(values), -1), 0
    for cluster in dict.fromkeys(found.tolist()):
        members = _still(values, np.flatnonzero(found == cluster))
        if len(members) >= LEAST_PHOTOS:
            rows[members] = number
            number += 1
    return rows


def _still(values: np.ndarray, members: np.ndarray) -> np.ndarray:
    """Those of a cluster's members [m] that are near its median; none where most are not, as `STILL` says."""
    while len(members):
        away = np.linalg.norm(values[members] - np.median(values[members], axis=0), axis=1)
        if away.max() <= MOST_AWAY:
            return members if np.median(away) <= STILL else members[:0]
        members = members[away <= MOST_AWAY]
    return members
