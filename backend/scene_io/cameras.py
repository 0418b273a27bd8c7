"""Makes Blender cameras from the pinhole model of photos, and the reverse.

A camera's frame is its photo: `lens` and `sensor` hold the focal length, `shift_x`/`shift_y` the principal point. The
aspect of the pixels (fl_x / fl_y) is a setting of the scene in Blender, not of the camera.
"""

from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Matrix

from .capture_files import Frame

SENSOR_MM = 36.0
CLIP_RANGE = (1e-3, 1e5)  # of the camera's distance to the world's origin, at least


@dataclass(frozen=True)
class Intrinsics:
    """Focal lengths and principal point in pixels; cx, cy from the top left."""

    fl_x: float
    fl_y: float
    cx: float
    cy: float


def new_camera(frame: Frame, collection: bpy.types.Collection, name: str) -> bpy.types.Object:
    """A camera object with the frame's pinhole model and pose. The scene must have the `pixel_aspect` of the frame."""
    data = bpy.data.cameras.new(name)
    data.sensor_fit, data.sensor_width = "HORIZONTAL", SENSOR_MM
    data.lens = frame.fl_x * SENSOR_MM / frame.width
    data.shift_x = 0.5 - frame.cx / frame.width
    data.shift_y = (frame.cy - frame.height / 2) / frame.width * (frame.fl_x / frame.fl_y)
    distance = float(np.linalg.norm(frame.matrix[:3, 3])) or 1.0
    data.clip_start, data.clip_end = CLIP_RANGE[0] * distance, CLIP_RANGE[1] * distance
    camera = bpy.data.objects.new(name, data)
    camera.matrix_world = Matrix(frame.matrix.tolist())
    collection.objects.link(camera)
    return camera


def pixel_aspect(frame: Frame) -> tuple[float, float]:
    """The scene's pixel_aspect_x and pixel_aspect_y that the frame's camera needs (Blender allows no value under 1)."""
    aspect = frame.fl_x / frame.fl_y  # a pixel's height over its width
    return max(1.0, 1 / aspect), max(1.0, aspect)


def intrinsics(data: bpy.types.Camera, width: int, height: int, aspect: tuple[float, float] = (1.0, 1.0)) -> Intrinsics:
    """Of the perspective camera `data`, whose frame is an image of width x height pixels of `aspect` (x, y)."""
    ratio = aspect[0] / aspect[1]  # a pixel's width over its height
    fit = data.sensor_fit
    if fit == "AUTO":
        fit = "HORIZONTAL" if width * ratio >= height else "VERTICAL"
        sensor = data.sensor_width  # AUTO fits the sensor's width to the longer side
    else:
        sensor = data.sensor_width if fit == "HORIZONTAL" else data.sensor_height
    # the fitted side in pixels of the image's rows and columns: the unit of the shift, and the sensor's extent
    unit_x, unit_y = (width, width * ratio) if fit == "HORIZONTAL" else (height / ratio, height)
    return Intrinsics(
        data.lens / sensor * unit_x,
        data.lens / sensor * unit_y,
        width / 2 - data.shift_x * unit_x,
        height / 2 + data.shift_y * unit_y,
    )
