"""Cameras with or without lens distortion.

Cameras look down -z, x right, y up; matrices are camera-to-world; pixel centers lie at +0.5. Without distortion, a pixel
(row y, column x) looks along ((x + 0.5 - cx) / fl_x, -(y + 0.5 - cy) / fl_y, -1) in the camera's own axes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import torch

from blender_nep.capture.cameras.lens import NO_DISTORTION, Lens, Lenses

_TO_OPENCV = np.array([1.0, -1.0, -1.0])
"""Turns the camera's own axes (y up, looking down -z) into those of `Lenses` (y down, looking along +z), and back."""


_QUARTER = np.array([[0.0, 1, 0, 0], [-1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
"""Turns the own axes of a camera of stored pixels into those of the image that was turned clockwise by a quarter"""


@dataclass(frozen=True)
class Camera:
    """A camera: size and intrinsics in pixels, `camera_to_world` [4, 4] float64 in the capture's frame, and its lens."""

    width: int
    height: int
    fl_x: float
    fl_y: float
    cx: float
    cy: float
    camera_to_world: np.ndarray
    lens: Lens = NO_DISTORTION

    @property
    def position(self) -> np.ndarray:
        """The center of projection [3], capture frame."""
        return self.camera_to_world[:3, 3]

    @property
    def optical_axis(self) -> np.ndarray:
        """Unit direction [3] through the image's center, capture frame."""
        return self.directions(np.array([self.width / 2.0]), np.array([self.height / 2.0]))[0]

    @property
    def field_of_view(self) -> float:
        """Angle (radians) between what the left and the right edge show, in the row of the principal point.

        Distortion counts. A fisheye may see more than pi.
        """
        x, _, z = self._own_directions(np.array([0.0, self.width]), np.full(2, self.cy)).T
        left, right = np.arctan2(x, -z)
        return float(right - left)

    def directions(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Unit directions [n, 3] in the capture frame, through image positions x, y [n] in pixels (centers +0.5)."""
        world = self._own_directions(x, y) @ self.camera_to_world[:3, :3].T
        return world / np.linalg.norm(world, axis=-1, keepdims=True)

    def _own_directions(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Directions [n, 3] in the camera's own axes, of any length, through image positions x, y [n]."""
        u, v = (x - self.cx) / self.fl_x, (y - self.cy) / self.fl_y
        if self.lens.is_pinhole:
            return np.stack([u, -v, -np.ones_like(u)], -1)
        return Lenses.of([self.lens]).directions(*map(torch.from_numpy, (u, v)))[0].numpy() * _TO_OPENCV

    def shown_pixels(self, width: int, height: int) -> np.ndarray:
        """Whether the lens shows anything in each pixel [H * W] bool of the image resampled to this size, row by row.

        It does not where its distortion folds.
        """
        if self.lens.is_pinhole:
            return np.ones(width * height, bool)
        small = self.scaled(width, height)
        return _shown_pixels(self.lens, width, height, small.fl_x, small.fl_y, small.cx, small.cy)

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Image positions x, y [n] in pixels, and depths [n] along -z, of `points` [n, 3] in the capture frame.

        A point with depth <= 0 lies behind the camera; its x and y mean nothing. A point that the lens cannot show gets the
        depth -inf.
        """
        local = (points - self.position) @ self.camera_to_world[:3, :3]
        depth = -local[:, 2]
        if not self.lens.is_pinhole:
            u, v, shown = (a.numpy() for a in Lenses.of([self.lens]).places(torch.from_numpy(local * _TO_OPENCV)))
            return self.cx + self.fl_x * u, self.cy + self.fl_y * v, np.where((depth > 0) & ~shown, -np.inf, depth)
        safe = np.where(depth > 1e-12, depth, np.inf)
        return self.cx + self.fl_x * local[:, 0] / safe, self.cy - self.fl_y * local[:, 1] / safe, depth

    def side_distances(self, point: np.ndarray) -> np.ndarray:
        """Signed distances [4] of `point` [3] from the left, right, top and bottom side of the view frustum.

        They are positive inside, in capture units. A side of a distorted image is bent; its middle counts.
        """
        local = (np.asarray(point) - self.position) @ self.camera_to_world[:3, :3]
        middle = self._own_directions(
            np.array([0.0, self.width, self.cx, self.cx]), np.array([self.cy, self.cy, 0.0, self.height])
        )
        x, y, z = middle.T
        zero = np.zeros(2)
        normals = np.concatenate(
            [
                np.stack([[-z[0], z[1]], zero, [x[0], -x[1]]], -1),
                np.stack([zero, [z[2], -z[3]], [-y[2], y[3]]], -1),
            ]
        )
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        return normals @ local

    def as_stored(self, quarter_turns: int) -> Camera:
        """The camera of the stored pixels, if this is that of the image which was turned clockwise `quarter_turns` times.

        The lens must have no skew.
        """
        camera = self
        for _ in range(quarter_turns % 4):  # back by one quarter: x = y', y = width' - x'
            lens = replace(camera.lens, p1=-camera.lens.p2, p2=camera.lens.p1)
            matrix = camera.camera_to_world @ _QUARTER
            center = camera.cy, camera.width - camera.cx
            camera = Camera(camera.height, camera.width, camera.fl_y, camera.fl_x, *center, matrix, lens)
        return camera

    def scaled(self, width: int, height: int) -> Camera:
        """The same camera, after its image was resampled to another size of the same aspect."""
        sx, sy = width / self.width, height / self.height
        intrinsics = self.fl_x * sx, self.fl_y * sy, self.cx * sx, self.cy * sy
        return Camera(width, height, *intrinsics, self.camera_to_world, self.lens)


@lru_cache(maxsize=4)
def _shown_pixels(lens: Lens, width: int, height: int, fl_x: float, fl_y: float, cx: float, cy: float) -> np.ndarray:
    """`Camera.shown_pixels`. The photos of a capture often share one camera, so the last results are kept.

    A lens folds at a radius. So it shows all pixels if it shows those at the border, and nearly all lenses do.
    """

    def shown(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        u, v = torch.from_numpy((x - cx) / fl_x), torch.from_numpy((y - cy) / fl_y)
        return Lenses.of([lens]).directions(u, v)[2].numpy()

    x, y = np.arange(width) + 0.5, np.arange(height) + 0.5
    top, left = np.full(width, 0.5), np.full(height, 0.5)
    border_x = np.concatenate([x, x, left, width - left])
    border_y = np.concatenate([top, height - top, y, y])
    if shown(border_x, border_y).all():
        return np.ones(width * height, bool)
    return shown(np.tile(x, height), np.repeat(y, width))
