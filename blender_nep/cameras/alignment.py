"""Brings two sets of cameras of the same photos into one frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from blender_nep.capture.cameras.camera import Camera


def similarity(found: Sequence[Camera], true: Sequence[Camera]) -> tuple[np.ndarray, float, np.ndarray]:
    """(rotation [3, 3], scale, translation [3]) that carries the cameras `found` onto the cameras `true`.

    The rotation is the mean over the cameras (chordal, by SVD). Scale and translation fit the positions by least squares.
    """
    total = sum(t.camera_to_world[:3, :3] @ f.camera_to_world[:3, :3].T for f, t in zip(found, true, strict=True))
    u, _, v = np.linalg.svd(np.asarray(total))
    turn = u @ np.diag([1, 1, np.sign(np.linalg.det(u @ v))]) @ v
    a = np.stack([f.position for f in found]) @ turn.T
    b = np.stack([t.position for t in true])
    centered = a - a.mean(0)
    scale = float((centered * (b - b.mean(0))).sum() / (centered**2).sum())
    return turn, scale, b.mean(0) - scale * a.mean(0)


def moved(camera: Camera, turn: np.ndarray, scale: float, shift: np.ndarray) -> Camera:
    """The camera after the similarity x -> scale * turn @ x + shift."""
    matrix = camera.camera_to_world.copy()
    matrix[:3, :3] = turn @ matrix[:3, :3]
    matrix[:3, 3] = scale * turn @ matrix[:3, 3] + shift
    return replace(camera, camera_to_world=matrix)


def angle(rotation: np.ndarray) -> float:
    """Angle [degrees] of a rotation [3, 3]; also exact for small angles."""
    skew = rotation - rotation.T
    sine = 0.5 * np.linalg.norm([skew[2, 1], skew[0, 2], skew[1, 0]])
    return float(np.degrees(np.arctan2(sine, 0.5 * (np.trace(rotation) - 1))))
