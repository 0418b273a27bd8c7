"""Places cameras on a circle around an object, and renders it from there."""

import math
from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np

from ..scene_io.capture_files import Frame
from ..scene_io.srgb import linear_to_srgb
from .exposure import exposure
from .relight import RelitScene

FILE = "turntable.png"
"""In an asset's folder: FRAMES square frames of SIZE pixels, side by side"""
FRAMES, SIZE, SAMPLES = 8, 160, 16
BACKDROP = 0.07  # linear; a dark gray, before which bright and dark objects are seen
FIELD_OF_VIEW = math.radians(30)
ELEVATION = math.radians(18)
MARGIN = 1.08  # the frames see a sphere that is larger than the object's by this factor
LEVEL_DEGREES = 30.0  # Z is taken as up where the angle between Z and the photos' mean up direction is smaller than this


def render_turntable(
    item: bpy.types.Object,
    frames: list[Frame],
    world: bpy.types.World,
    *,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> np.ndarray:
    """Render FRAMES views around `item` before a gray backdrop: [SIZE, FRAMES * SIZE, 3] uint8, sRGB-encoded.

    `world` lights the object. `frames` are the photos' cameras, which tell what is up. progress(done, total) is called after
    every render.
    """
    views = turntable_frames(item, frames, FRAMES, SIZE)
    with RelitScene(item, SIZE, SIZE, SAMPLES, seed) as relit:
        tiles = []
        for number, view in enumerate(views, start=1):
            tiles.append(relit.render_cut_out(view, world))
            if progress:
                progress(number, FRAMES)
    strip = np.concatenate(tiles, axis=1)
    shown = strip[strip[..., 3] > 0.5]
    gain = exposure(shown[:, :3]) if len(shown) else 1.0
    coverage = np.clip(strip[..., 3:], 0, 1)
    return np.round(255 * linear_to_srgb(strip[..., :3] * gain + (1 - coverage) * BACKDROP)).astype(np.uint8)


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
