"""From which directions the photos show the object, and where photos are missing.

Directions are told in an upright frame. Its z axis is the capture's, as long as the photos agree with that. Cameras that
were found from photos alone often have another z axis: then up is what is up in the photos.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from blender_nep.capture.capture import Capture
from blender_nep.messages import Message

COVERED = 30.0
"""A direction counts as covered if it lies within this many degrees of a photo."""
PROBES = 8192
"""Number of directions, spread evenly, at which coverage is measured; neighbors are 2 degrees apart."""
LARGEST_GAP = 45.0
"""Degrees from a direction to the nearest photo from which on an artist is told to take more photos. Directions below the
horizon do not count: a table hides them."""
STRAIGHT = 60.0
"""A hole that lies higher (or lower) than this many degrees is called straight above (or below)."""
MOST_TILT = 30.0
"""If up in the photos differs from the z axis by more than this many degrees, it counts instead of the z axis."""
LEVEL, SPREAD = 0.1, 0.3
"""Up in the photos is the direction to which the photos' horizontal axes are perpendicular. It is known if the axes' mean
square along it is at most `LEVEL`, and at least `SPREAD` along every other direction."""


@dataclass(frozen=True)
class Hole:
    """A direction around which there is no photo."""

    direction: np.ndarray
    """[3]: unit, upright frame"""
    degrees: float
    """Angle to the nearest photo"""
    before: str
    """Name of the nearest photo on one side: at smaller azimuth"""
    after: str
    """... and on the other side, at larger azimuth"""

    @property
    def azimuth(self) -> float:
        """Degrees from the x axis towards the y axis, 0 .. 360."""
        return math.degrees(math.atan2(self.direction[1], self.direction[0])) % 360

    @property
    def elevation(self) -> float:
        """Degrees above the horizon, -90 .. 90."""
        return math.degrees(math.asin(float(np.clip(self.direction[2], -1, 1))))

    def message(self) -> Message:
        """The hole in words."""
        if self.elevation > STRAIGHT:
            return Message("capture.hole_above", {"degrees": self.degrees})
        if self.elevation < -STRAIGHT:
            return Message("capture.hole_below", {"degrees": self.degrees})
        place = {
            "degrees": self.degrees,
            "azimuth": self.azimuth,
            "elevation": self.elevation,
            "before": self.before,
            "after": self.after,
        }
        return Message("capture.hole_beside", place)


@dataclass(frozen=True)
class Coverage:
    """The directions of the photos."""

    directions: np.ndarray
    """[n, 3]: unit directions from the object's center to the cameras, upright frame"""
    names: Sequence[str]
    """[n] names of the photos"""
    z_up: bool
    """Up is the capture's z axis. False: up is what is up in the photos."""

    @classmethod
    def of(cls, capture: Capture) -> Coverage:
        """The coverage of a capture's cameras around its object's sphere."""
        place = np.stack([view.camera.position for view in capture.views]) - capture.object_center
        upright = _upright(np.stack([view.camera.camera_to_world[:3, :3] for view in capture.views]))
        directions = place / np.linalg.norm(place, axis=1, keepdims=True)
        names = [view.name for view in capture.views]
        return cls(directions if upright is None else directions @ upright.T, names, upright is None)

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.directions)

    def angles(self, directions: np.ndarray) -> np.ndarray:
        """Degrees [m] from unit directions [m, 3] (upright frame) to the nearest photo, 0 .. 180."""
        chord = self._tree.query(directions)[0]
        return np.degrees(2 * np.arcsin(np.clip(chord / 2, 0, 1)))

    @cached_property
    def share(self) -> float:
        """Share of all directions that lie within COVERED degrees of a photo, 0 .. 1."""
        return float((self.angles(_probes()) <= COVERED).mean())

    def largest_hole(self, least_elevation: float = -90.0) -> Hole:
        """The direction that is farthest from all photos, among those at least this many degrees above the horizon."""
        probes = _probes()
        probes = probes[probes[:, 2] >= math.sin(math.radians(least_elevation))]
        angles = self.angles(probes)
        direction = probes[angles.argmax()]
        return Hole(direction, float(angles.max()), *self._beside(direction))

    def _beside(self, direction: np.ndarray) -> tuple[str, str]:
        """Names of the photos that are nearest to a direction [3], on its two sides. One name twice if one side is empty."""
        cosine = self.directions @ direction
        azimuth = np.arctan2(self.directions[:, 1], self.directions[:, 0])
        later = (azimuth - math.atan2(direction[1], direction[0])) % (2 * math.pi) < math.pi
        sides = [side if side.any() else ~side for side in (~later, later)]
        before, after = (self.names[int(np.where(side, cosine, -2).argmax())] for side in sides)
        return before, after


def _probes() -> np.ndarray:
    """PROBES unit directions [n, 3], spread evenly (a Fibonacci spiral)."""
    number = np.arange(PROBES) + 0.5
    z = 1 - 2 * number / PROBES
    around = number * math.pi * (1 + math.sqrt(5))
    across = np.sqrt(1 - z**2)
    return np.stack([across * np.cos(around), across * np.sin(around), z], 1)


def _upright(rotations: np.ndarray) -> np.ndarray | None:
    """The shortest rotation [3, 3] that brings what is up in the photos to the z axis. None: the z axis is up.

    rotations [n, 3, 3]: camera to world. A photo's horizontal axis is level if nobody tilted the camera. Where up cannot be
    told from these axes, the z axis is up.
    """
    level = rotations[:, :, 0]
    square, axes = np.linalg.eigh(level.T @ level / len(level))
    if square[0] > LEVEL or square[1] < SPREAD:
        return None
    up = axes[:, 0] * np.sign(axes[:, 0] @ rotations[:, :, 1].mean(0) + 1e-12)
    if up[2] > math.cos(math.radians(MOST_TILT)):
        return None
    half = up + np.array([0.0, 0.0, 1.0])
    if half @ half < 1e-9:  # straight down: turn about the x axis
        return np.diag([1.0, -1.0, -1.0])
    turn = 2 * np.outer(half, half) / (half @ half) - np.eye(3)  # turns by 180 degrees about `half`
    about_up = np.diag([-1.0, -1.0, 1.0])
    return about_up @ turn
