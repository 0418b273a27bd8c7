"""Holds an improved camera near the given one, as far as its photo does not tell better.

A photo of a plain wall shows few scene points, and all in one corner. They can hardly tell a turn of the camera from a
shift. So a camera that was adjusted to these points alone may be worse than what was given.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from blender_nep.capture.cameras.camera import Camera

_INEXACT_POINTS = 3.0
"""Errors of features count as so much larger than they look: they are not independent, and scene points err, too."""
_FAR = 2.0
"""Differences beyond so many standard deviations count linearly, and not by their square."""
_BEHIND = 1e4
"""Pixels: the error of a scene point that the camera cannot show"""


@dataclass(frozen=True)
class Spread:
    """Standard deviations of errors, for each axis."""

    turn: float
    """Of the given cameras' directions [radians]"""
    shift: float
    """Of the given cameras' places, in units of the scene"""
    features: float
    """Of the places of features [pixels]"""


def held(given: Camera, improved: Camera, seen: np.ndarray, spread: Spread) -> Camera:
    """The most probable camera: the mode of the posterior whose prior is the given camera, with its spread.

    seen [n, 5]: the place of a feature in the photo [pixels], and its scene point in the frame of both cameras. The result
    has the intrinsics of `improved`.
    """
    scale = np.repeat([spread.turn, spread.shift], 3)
    if not scale.all():
        return replace(improved, camera_to_world=given.camera_to_world)
    matrix, start = given.camera_to_world, np.empty(6)
    start[:3] = Rotation.from_matrix(improved.camera_to_world[:3, :3] @ matrix[:3, :3].T).as_rotvec()
    start[3:] = improved.position - given.position

    def camera(change: np.ndarray) -> Camera:
        moved = matrix.copy()
        moved[:3, :3] = Rotation.from_rotvec(change[:3] * scale[:3]).as_matrix() @ moved[:3, :3]
        moved[:3, 3] += change[3:] * scale[3:]
        return replace(improved, camera_to_world=moved)

    def differences(change: np.ndarray) -> np.ndarray:
        away = off(camera(change), seen) / (_INEXACT_POINTS * spread.features)
        return np.concatenate([away.ravel(), change])

    return camera(least_squares(differences, start / scale, loss="soft_l1", f_scale=_FAR).x)


def off(camera: Camera, seen: np.ndarray) -> np.ndarray:
    """How far [pixels] the projections of scene points lie beside their features: [n, 2]. `seen` as in `held`."""
    x, y, _ = camera.project(seen[:, 2:])
    return np.nan_to_num(np.stack([x, y], 1) - seen[:, :2], nan=_BEHIND).clip(-_BEHIND, _BEHIND)
