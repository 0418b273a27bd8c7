"""Makes a Blender camera from the pinhole model of a photo, and a pinhole model from a Blender camera.

The frame of the Blender camera is exactly the photo. The camera's `lens` and `sensor` hold the focal length, its `shift_x`
and `shift_y` the principal point. The aspect of the pixels (fl_x / fl_y) is a setting of the scene in Blender, not of the
camera.
"""

from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Matrix

from .capture_files import Frame

SENSOR_MM = 36.0
CLIP_RANGE = (1e-3, 1e5)  # nearest and farthest visible distance, as factors of the camera's distance to the world's origin


@dataclass(frozen=True)
class Intrinsics:
    """Focal lengths and principal point of a photo in pixels. cx and cy count from the top left corner."""

    fl_x: float
    fl_y: float
    cx: float
    cy: float


def new_camera(frame: Frame, collection: bpy.types.Collection, name: str) -> bpy.types.Object:
    """Add a camera object with the frame's pinhole model and pose to `collection`, and return it.

    The scene's pixel aspect must be the `pixel_aspect` of the frame.
    """
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
    """(pixel_aspect_x, pixel_aspect_y) that the scene needs for the frame's camera. Blender allows no value under 1."""
    aspect = frame.fl_x / frame.fl_y  # a pixel's height over its width
    return max(1.0, 1 / aspect), max(1.0, aspect)


def intrinsics(data: bpy.types.Camera, width: int, height: int, aspect: tuple[float, float] = (1.0, 1.0)) -> Intrinsics:
    """The intrinsics of the perspective camera `data`.

    The camera's frame is an image of width x height pixels. `aspect` is the scene's (pixel_aspect_x, pixel_aspect_y).
    """
    ratio = aspect[0] / aspect[1]  # a pixel's width over its height
    fit = data.sensor_fit
    if fit == "AUTO":
        fit = "HORIZONTAL" if width * ratio >= height else "VERTICAL"
        sensor = data.sensor_width  # AUTO fits the sensor's width to the longer side of the image
    else:
        sensor = data.sensor_width if fit == "HORIZONTAL" else data.sensor_height
    # The length of the fitted side, in widths of a pixel and in heights of a pixel. The camera's shift is counted in this
    # length, and the sensor's size is this length.
    unit_x, unit_y = (width, width * ratio) if fit == "HORIZONTAL" else (height / ratio, height)
    return Intrinsics(
        data.lens / sensor * unit_x,
        data.lens / sensor * unit_y,
        width / 2 - data.shift_x * unit_x,
        height / 2 + data.shift_y * unit_y,
    )
