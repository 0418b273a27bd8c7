"""The support plane on which an object stands, such as a table."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Support:
    """A support plane: the points x with normal . x = height, in the unit frame. The object stands on the side of normal."""

    normal: np.ndarray
    """[3] unit vector"""
    height: float

    @property
    def radius(self) -> float:
        """Radius of the disc that the unit sphere cuts out of the plane. 0 if the plane misses the sphere."""
        return float(np.sqrt(max(1 - self.height**2, 0.0)))

    def axes(self) -> tuple[np.ndarray, np.ndarray]:
        """Two unit vectors [3] that span the plane."""
        normal = np.asarray(self.normal, np.float64)
        across = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
        across /= np.linalg.norm(across)
        return across, np.cross(normal, across)

    def square(self, axis: np.ndarray) -> np.ndarray:
        """Points [n, n, 3] of the plane whose places along its two axes are those of axis [n]."""
        across, along = self.axes()
        square = axis[:, None, None] * across + axis[None, :, None] * along
        return square + self.height * np.asarray(self.normal)

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Signed distances [...] of points [..., 3] from the plane, positive on the object's side."""
        return points @ np.asarray(self.normal) - self.height

    def state(self) -> dict:
        """The plane as a dict of lists and numbers."""
        return {"normal": [float(c) for c in self.normal], "height": float(self.height)}

    @classmethod
    def from_state(cls, state: dict) -> Support:
        """The inverse of `state`."""
        return cls(np.array(state["normal"]), state["height"])


def ring(support: Support, inner: float, width: float, count: int) -> np.ndarray:
    """Evenly spread points [count, 3] of the plane between the radii `inner` and `inner` + `width`: a Fibonacci spiral."""
    k = np.arange(count) + 0.5
    radius = np.sqrt(inner**2 + ((inner + width) ** 2 - inner**2) * k / count)
    angle = np.pi * (1 + np.sqrt(5)) * k
    across, along = support.axes()
    points = radius[:, None] * (np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * along)
    return points + support.height * np.asarray(support.normal)
