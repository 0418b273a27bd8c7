"""Pinhole cameras.

Cameras look down -z, x right, y up; matrices are camera-to-world; pixel centres lie at +0.5, so a pixel (row y,
column x) looks along ((x + 0.5 - cx) / fl_x, -(y + 0.5 - cy) / fl_y, -1) in the camera's own axes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Camera:
    """A pinhole camera: size and intrinsics in pixels, `camera_to_world` [4, 4] float64 in the capture's frame."""

    width: int
    height: int
    fl_x: float
    fl_y: float
    cx: float
    cy: float
    camera_to_world: np.ndarray

    @property
    def position(self) -> np.ndarray:
        """The centre of projection [3], capture frame."""
        return self.camera_to_world[:3, 3]

    @property
    def optical_axis(self) -> np.ndarray:
        """Unit direction [3] through the image's centre, capture frame."""
        return self.directions(np.array([self.width / 2.0]), np.array([self.height / 2.0]))[0]

    def directions(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Unit directions [n, 3] in the capture frame, through image positions x, y [n] in pixels (centres +0.5)."""
        local = np.stack([(x - self.cx) / self.fl_x, -(y - self.cy) / self.fl_y, -np.ones_like(x)], -1)
        world = local @ self.camera_to_world[:3, :3].T
        return world / np.linalg.norm(world, axis=-1, keepdims=True)

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Image positions x, y [n] in pixels, and depths [n] along -z, of `points` [n, 3] in the capture frame.

        A point with depth <= 0 lies behind the camera; its x and y mean nothing.
        """
        local = (points - self.position) @ self.camera_to_world[:3, :3]
        depth = -local[:, 2]
        safe = np.where(depth > 1e-12, depth, np.inf)
        return self.cx + self.fl_x * local[:, 0] / safe, self.cy - self.fl_y * local[:, 1] / safe, depth

    def side_distances(self, point: np.ndarray) -> np.ndarray:
        """Signed distances [4] of `point` [3] from the left, right, top and bottom side of the view frustum.

        They are positive inside, in capture units.
        """
        local = (np.asarray(point) - self.position) @ self.camera_to_world[:3, :3]
        left, right = -self.cx / self.fl_x, (self.width - self.cx) / self.fl_x
        top, bottom = self.cy / self.fl_y, -(self.height - self.cy) / self.fl_y
        normals = np.array([[1, 0, left], [-1, 0, -right], [0, -1, -top], [0, 1, bottom]], np.float64)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        return normals @ local

    def scaled(self, width: int, height: int) -> Camera:
        """The same camera, after its image was resampled to another size of the same aspect."""
        sx, sy = width / self.width, height / self.height
        return Camera(width, height, self.fl_x * sx, self.fl_y * sy, self.cx * sx, self.cy * sy, self.camera_to_world)
