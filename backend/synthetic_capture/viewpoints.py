"""Chooses where the cameras stand: around the object, outside all obstacles, with a clear view of the object."""

import math
from dataclasses import dataclass

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


class Surroundings:
    """The obstacles, which are everything but the object, in a form that rays can be cast against."""

    def __init__(self, obstacles: list[bpy.types.Object]):
        vertices, faces, count = [], [], 0
        bpy.context.view_layer.update()
        for item in obstacles:
            points, corners = triangles(item)
            vertices.append(points)
            faces.append(corners + count)
            count += len(points)
        self.tree = BVHTree.FromPolygons(np.concatenate(vertices).tolist(), np.concatenate(faces).tolist())
        self.targets = [Vector(point) for point in (fibonacci_sphere(200) * OBJECT_RADIUS).tolist()]

    def clear_fraction(self, position: Vector) -> float:
        """The fraction of the straight lines from `position` to the object's bounding sphere that meet no obstacle.

        A position inside a closed obstacle gets 0, because every line meets the obstacle's wall.
        """
        clear = 0
        for target in self.targets:
            line = target - position
            clear += self.tree.ray_cast(position, line.normalized(), line.length)[0] is None
        return clear / len(self.targets)

    def usable(self, position: Vector) -> bool:
        """Whether a camera may stand at `position`: inside the room, away from obstacles, with a clear view."""
        if not FLOOR + CLEARANCE < position.z < CEILING - CLEARANCE:
            return False
        nearest = self.tree.find_nearest(position)[3]
        return nearest is not None and nearest > CLEARANCE and self.clear_fraction(position) >= CLEAR_FRACTION


def fibonacci_sphere(count: int) -> np.ndarray:
    """`count` unit vectors [count,3], spread evenly over the sphere on a golden-angle spiral."""
    index = np.arange(count) + 0.5
    z = 1 - 2 * index / count
    angle = index * math.pi * (3 - math.sqrt(5))
    ring = np.sqrt(1 - z**2)
    return np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)


def choose_viewpoints(count: int, surroundings: Surroundings, rng: np.random.Generator) -> list[Viewpoint]:
    """`count` usable viewpoints, spread over ELEVATIONS and DISTANCES.

    Where a place is not usable, a random place near it is tried; each further try may be farther away. Raises ValueError
    where the scene has no usable place.
    """
    low, high = (math.sin(math.radians(angle)) for angle in ELEVATIONS)
    turn = rng.uniform(0, 2 * math.pi)
    chosen = []
    for index in range(count):
        height, angle = low + (high - low) * (index + 0.5) / count, turn + index * math.pi * (3 - math.sqrt(5))
        for attempt in range(TRIES):
            spread = attempt / TRIES
            z = float(np.clip(height + spread * rng.normal(0, 0.5), low, high))
            a = angle + rng.normal(0, 0.1 + 2 * spread)
            ring = math.sqrt(1 - z * z)
            position = Vector((ring * math.cos(a), ring * math.sin(a), z)) * rng.uniform(*DISTANCES) * OBJECT_RADIUS
            if surroundings.usable(position):
                break
        else:
            raise ValueError("no free place for a camera in this scene: give another --seed")
        aim = Vector(rng.uniform(-0.06, 0.06, 3).tolist())
        rotation = (aim - position).to_track_quat("-Z", "Y").to_matrix().to_4x4()
        chosen.append(Viewpoint(Matrix.Translation(position) @ rotation))
    return chosen
