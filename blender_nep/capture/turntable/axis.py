"""The axis about which the object of a turntable turns, found from the cameras in the object's frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

LEAST_TURN, MOST_TURN = 4.0, 176.0
"""degrees between which the turn from one photo to another tells the axis well"""
SAME_AXIS = 1.5
"""Two turns are about the same axis if their axes differ by less than this many degrees."""
_PAIRS, _CANDIDATES = 60_000, 400
"""At most about so many pairs of photos are looked at, and so many of their axes are tried."""


@dataclass(frozen=True)
class Axis:
    """A line in the capture's frame."""

    direction: np.ndarray
    """[3], a unit vector, upwards as most photos show it"""
    point: np.ndarray
    """[3]: the point of the line that is nearest to the origin"""

    def turn(self, radians: float) -> np.ndarray:
        """The rigid motion [4, 4] that turns about the line, counterclockwise as seen from above."""
        x, y, z = self.direction
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        matrix = np.eye(4)
        matrix[:3, :3] += np.sin(radians) * cross + (1 - np.cos(radians)) * cross @ cross
        matrix[:3, 3] = self.point - matrix[:3, :3] @ self.point
        return matrix

    def in_cameras(self, poses: np.ndarray) -> np.ndarray:
        """Where the line lies for cameras with the camera-to-object poses [n, 4, 4]: [n, 6].

        The first three numbers are its direction in the camera's frame, the others the vector from the camera to the nearest
        point of the line. Both stay the same while the object turns before a still camera.
        """
        rotation, place = poses[:, :3, :3], poses[:, :3, 3]
        across = self.point - place
        across = across - (across @ self.direction)[:, None] * self.direction
        return np.concatenate([self.direction @ rotation, np.einsum("nij,ni->nj", rotation, across)], 1)

    def height(self, places: np.ndarray) -> np.ndarray:
        """How high places [n, 3] lie along the line, [n]."""
        return places @ self.direction

    def azimuth(self, vector: np.ndarray) -> float:
        """The angle of a vector [3] about the line, in radians, counterclockwise as seen from above."""
        first = np.cross(self.direction, np.eye(3)[np.abs(self.direction).argmin()])
        first /= np.linalg.norm(first)
        return float(np.arctan2(vector @ np.cross(self.direction, first), vector @ first))


def find_axis(poses: np.ndarray, rows: np.ndarray | None = None) -> Axis | None:
    """The axis about which the object turned between most pairs of photos; None if there is none.

    `poses` [n, 4, 4]: camera-to-object. `rows` [n]: the row of each photo, -1 for none; only pairs of one row are looked at.
    None: not known yet, so all pairs are. Between photos of one row the motion is a turn about the axis, whatever the camera
    is. Between photos of two rows it is not.
    """
    one, other = _pairs(len(poses), rows)
    if not len(one):
        return None
    turns = poses[one, :3, :3] @ poses[other, :3, :3].transpose(0, 2, 1)
    vector = np.stack([turns[:, 2, 1] - turns[:, 1, 2], turns[:, 0, 2] - turns[:, 2, 0], turns[:, 1, 0] - turns[:, 0, 1]], 1)
    sine = np.linalg.norm(vector, axis=1) / 2
    clear = sine > np.sin(np.radians(LEAST_TURN))
    if not clear.any():
        return None
    one, other, turns, vector = one[clear], other[clear], turns[clear], vector[clear] / (2 * sine[clear, None])
    tried = vector[:: max(1, len(vector) // _CANDIDATES)]
    alike = np.abs(tried @ vector.T) > np.cos(np.radians(SAME_AXIS))
    chosen = alike[alike.sum(1).argmax()]
    direction = np.linalg.eigh(vector[chosen].T @ vector[chosen])[1][:, -1]
    up = poses[:, :3, 1].sum(0)
    direction = direction if direction @ up >= 0 else -direction
    return Axis(direction, _fixed_point(turns[chosen], poses[one[chosen]], poses[other[chosen]], direction))


def _pairs(count: int, rows: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """The two photos [k] of each pair that is looked at."""
    one, other = np.triu_indices(count, 1)
    if rows is not None:
        same = (rows[one] == rows[other]) & (rows[one] >= 0)
        one, other = one[same], other[same]
    step = max(1, len(one) // _PAIRS)
    return one[::step], other[::step]


def _fixed_point(turns: np.ndarray, ones: np.ndarray, others: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """The point [3] nearest to the origin that turns [k, 3, 3] leave in place, by least squares; camera poses [k, 4, 4]."""
    shift = ones[:, :3, 3] - np.einsum("kij,kj->ki", turns, others[:, :3, 3])
    across = np.eye(3) - np.outer(direction, direction)
    equations = np.concatenate([((np.eye(3) - turns) @ across).reshape(-1, 3), direction[None]])
    return np.linalg.lstsq(equations, np.concatenate([(shift @ across).reshape(-1), [0.0]]), rcond=None)[0]
