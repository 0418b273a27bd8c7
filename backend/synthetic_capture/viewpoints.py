"""Chooses where the cameras stand: around the object, outside all obstacles, with a clear view of the object."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import bpy
import numpy as np
from mathutils import Matrix, Vector
from mathutils.bvhtree import BVHTree

from .scenes import CEILING, FLOOR, OBJECT_RADIUS, triangles

ELEVATIONS = (-22.0, 62.0)  # degrees, seen from the object; below -22 the floor would be too near
DISTANCES = (2.75, 3.4)  # object radii; at the smallest distance the sphere of radius 1 just fits into FIELD_OF_VIEW
FIELD_OF_VIEW = math.radians(43)
CLEARANCE = 0.3  # smallest distance of a camera from any obstacle, in object radii
CLEAR_FRACTION = 0.98  # at least this fraction of the lines to the object's bounding sphere must meet no obstacle
TRIES = 400  # places that are tried for each camera


@dataclass(frozen=True)
class Viewpoint:
    """The pose of a camera. `matrix` is camera-to-world; the camera looks down -z, and y points up."""

    matrix: Matrix
    turn: Matrix = field(default_factory=lambda: Matrix.Identity(4))
    """The pose of the object: from the frame in which its mesh is given to the world. It differs on a turntable."""
    row: int | None = None
    """The row of photos of a turntable, each from one place of the camera. None: no turntable"""

    @property
    def in_object(self) -> Matrix:
        """Camera-to-object: the pose of the camera relative to the object."""
        return self.turn.inverted() @ self.matrix


@dataclass(frozen=True)
class Layout:
    """Where the cameras may stand, seen from the object."""

    elevations: tuple[float, ...] = ELEVATIONS
    """degrees: the lowest and the highest; with `rings`, one for each ring"""
    distances: tuple[float, float] = DISTANCES
    """object radii"""
    heights: tuple[float, float] = (FLOOR, CEILING)
    """the heights between which a camera stands"""
    rings: bool = False
    """whether the cameras stand on rings around the object"""


class Surroundings:
    """The obstacles, which are everything but the object, in a form that rays can be cast against."""

    def __init__(self, obstacles: Sequence[bpy.types.Object], support: Sequence[bpy.types.Object] = ()):
        """`support` holds what the object stands on. It does not count as hiding the object, which touches it."""
        bpy.context.view_layer.update()
        self.hiding = _tree(obstacles)
        self.solid = _tree([*obstacles, *support])
        self.targets = [Vector(point) for point in (fibonacci_sphere(200) * OBJECT_RADIUS).tolist()]

    def clear_fraction(self, position: Vector) -> float:
        """The fraction of the straight lines from `position` to the object's bounding sphere that meet no obstacle.

        A position inside a closed obstacle gets 0, because every line meets the obstacle's wall.
        """
        clear = 0
        for target in self.targets:
            line = target - position
            clear += self.hiding.ray_cast(position, line.normalized(), line.length)[0] is None
        return clear / len(self.targets)

    def usable(self, position: Vector, heights: tuple[float, float]) -> bool:
        """Whether a camera may stand at `position`: between these heights, away from obstacles, with a clear view."""
        if not heights[0] + CLEARANCE < position.z < heights[1] - CLEARANCE:
            return False
        nearest = self.solid.find_nearest(position)[3]
        return (nearest is None or nearest > CLEARANCE) and self.clear_fraction(position) >= CLEAR_FRACTION


def _tree(items: Sequence[bpy.types.Object]) -> BVHTree:
    vertices, faces, count = [np.zeros((0, 3))], [np.zeros((0, 3), np.int32)], 0
    for item in items:
        points, corners = triangles(item)
        vertices.append(points)
        faces.append(corners + count)
        count += len(points)
    return BVHTree.FromPolygons(np.concatenate(vertices).tolist(), np.concatenate(faces).tolist())


def fibonacci_sphere(count: int) -> np.ndarray:
    """`count` unit vectors [count,3], spread evenly over the sphere on a golden-angle spiral."""
    index = np.arange(count) + 0.5
    z = 1 - 2 * index / count
    angle = index * math.pi * (3 - math.sqrt(5))
    ring = np.sqrt(1 - z**2)
    return np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)


def choose_viewpoints(
    count: int, surroundings: Surroundings, rng: np.random.Generator, layout: Layout | None = None
) -> list[Viewpoint]:
    """`count` usable viewpoints, spread over the layout.

    Where a place is not usable, a random place near it is tried; each further try may be farther away. Raises ValueError
    where the scene has no usable place.
    """
    layout = layout or Layout()
    low, high = (math.sin(math.radians(angle)) for angle in (min(layout.elevations), max(layout.elevations)))
    turn = rng.uniform(0, 2 * math.pi)
    chosen = []
    for index in range(count):
        height, angle = low + (high - low) * (index + 0.5) / count, turn + index * math.pi * (3 - math.sqrt(5))
        if layout.rings:
            ring = layout.elevations[index % len(layout.elevations)]
            height, angle = math.sin(math.radians(ring)), turn + index * 2 * math.pi / count
        for attempt in range(TRIES):
            spread = attempt / TRIES
            z = float(np.clip(height + spread * rng.normal(0, 0.5), low, high))
            a = angle + rng.normal(0, 0.1 + 2 * spread)
            ring = math.sqrt(1 - z * z)
            position = Vector((ring * math.cos(a), ring * math.sin(a), z)) * rng.uniform(*layout.distances) * OBJECT_RADIUS
            if surroundings.usable(position, layout.heights):
                break
        else:
            raise ValueError("no free place for a camera in this scene: give another seed")
        aim = Vector(rng.uniform(-0.06, 0.06, 3).tolist())
        rotation = (aim - position).to_track_quat("-Z", "Y").to_matrix().to_4x4()
        chosen.append(Viewpoint(Matrix.Translation(position) @ rotation))
    return chosen
