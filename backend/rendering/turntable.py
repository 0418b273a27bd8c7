"""Places cameras on a circle around an object."""

import math
from pathlib import Path

import bpy
import numpy as np

from ..scene_io.capture_files import Frame

FIELD_OF_VIEW = math.radians(30)
ELEVATION = math.radians(18)
MARGIN = 1.08  # the frames see a sphere that is larger than the object's by this factor
LEVEL_DEGREES = 30.0  # Z is taken as up where the angle between Z and the photos' mean up direction is smaller than this


def turntable_frames(item: bpy.types.Object, frames: list[Frame], count: int, size: int) -> list[Frame]:
    """`count` square frames of `size` x `size` pixels that see all of `item`.

    Their cameras stand evenly spread on a circle around the `up_axis` of the photos.
    """
    corners = np.array([item.matrix_world @ vertex.co for vertex in item.data.vertices])
    center = (corners.min(axis=0) + corners.max(axis=0)) / 2
    radius = float(np.linalg.norm(corners - center, axis=1).max())
    up = up_axis(frames)
    ahead = np.cross(up, [1.0, 0.0, 0.0] if abs(up[0]) < 0.9 else [0.0, 1.0, 0.0])
    ahead /= np.linalg.norm(ahead)
    side = np.cross(up, ahead)
    distance = MARGIN * radius / math.sin(FIELD_OF_VIEW / 2)
    focal = size / 2 / math.tan(FIELD_OF_VIEW / 2)
    found = []
    for turn in 2 * math.pi * np.arange(count) / count:
        around = math.cos(turn) * -ahead + math.sin(turn) * side
        back = math.cos(ELEVATION) * around + math.sin(ELEVATION) * up
        right = np.cross(up, back)
        right /= np.linalg.norm(right)
        matrix = np.eye(4)
        matrix[:3] = np.stack([right, np.cross(back, right), back, center + distance * back], axis=1)
        found.append(Frame(Path("turntable"), size, size, focal, focal, size / 2, size / 2, matrix, "linear"))
    return found


def up_axis(frames: list[Frame]) -> np.ndarray:
    """The axis [3] that points up: a unit vector.

    It is the mean of the photos' up directions. It is Z where that mean is near Z (LEVEL_DEGREES) or has almost no length.
    """
    mean = np.mean([frame.matrix[:3, 1] for frame in frames], axis=0)
    length = float(np.linalg.norm(mean))
    if length < 1e-3 or mean[2] / length > math.cos(math.radians(LEVEL_DEGREES)):
        return np.array([0.0, 0.0, 1.0])
    return mean / length
