"""Finds cameras that are placed unlike the others, and tells how large the object's sphere is in the photos."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from blender_nep.capture.bounds import sees_sphere
from blender_nep.capture.capture import Capture
from blender_nep.messages import Message

FAR = 2.0
"""A camera stands much farther away than the others from this many times their median distance on. It stands much nearer
from the median divided by this number on."""
LEAST_PIXELS = 150.0
"""Width of the sphere in pixels under which an artist is told that the object is small."""
CUT = 0.8
"""A photo cuts off a part of the sphere if a side of the photo is nearer to the sphere's center than this many radii.
Bounding spheres are larger than objects, so a little may be cut off."""


@dataclass(frozen=True)
class SphereSize:
    """How large the object's sphere is in the photos."""

    pixels: float
    """Width in pixels of the photos as they are on the disk, median over the photos"""
    cut: float
    """Share of the photos that see the sphere and cut off a part of it"""

    @classmethod
    def of(cls, capture: Capture) -> SphereSize:
        """Measure it by the cameras. Lens distortion is left out."""
        center, radius = capture.object_center, capture.object_radius
        width, cut = [], []
        for view in capture.views:
            camera = view.camera
            if not sees_sphere(camera, center, radius):
                continue
            away = float(np.linalg.norm(camera.position - center)) / radius
            width.append(2 * math.sqrt(camera.fl_x * camera.fl_y) / math.sqrt(away**2 - 1))  # tan(asin(1 / away))
            cut.append(camera.side_distances(center).min() < CUT * radius)
        return cls(float(np.median(width)), float(np.mean(cut)))

    def messages(self) -> list[Message]:
        """Advice, if the sphere is small or if most photos cut it off."""
        found = [Message("capture.sphere_small", {"pixels": self.pixels})] if self.pixels < LEAST_PIXELS else []
        if self.cut > 0.5:
            found.append(Message("capture.sphere_at_edges", {"percent": 100 * self.cut}))
        return found


def camera_outliers(capture: Capture) -> list[Message]:
    """Messages on cameras that look past the object, and on cameras that stand much nearer or farther than the others.

    Photos that do not see the sphere at all are left out: loading the capture has named them.
    """
    center, radius = capture.object_center, capture.object_radius
    cameras = [view.camera for view in capture.views]
    distance = np.array([np.linalg.norm(camera.position - center) for camera in cameras]) / radius
    sees = np.array([sees_sphere(camera, center, radius) for camera in cameras])
    beside = np.array([_outside_of_frame(capture, view) for view in range(len(cameras))])
    middle = float(np.median(distance))
    away, near, distant = (
        [capture.views[i].name for i in np.flatnonzero(which)]
        for which in (sees & beside, distance < middle / FAR, distance > FAR * middle)
    )
    found = [Message("capture.cameras_look_away", {"count": len(away), "names": away})] if away else []
    if near:
        found.append(Message("capture.cameras_near", {"count": len(near), "names": near}))
    if distant:
        found.append(Message("capture.cameras_distant", {"count": len(distant), "names": distant}))
    return found


def _outside_of_frame(capture: Capture, view: int) -> bool:
    camera = capture.views[view].camera
    ahead = (camera.position - capture.object_center) @ camera.camera_to_world[:3, 2] > 0
    return not ahead or bool(camera.side_distances(capture.object_center).min() < 0)
