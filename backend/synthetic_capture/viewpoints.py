"""Chooses where the cameras stand: around the object, outside every obstacle, with a clear view of the object."""

import math
from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Matrix, Vector
from mathutils.bvhtree import BVHTree

from .scenes import CEILING, FLOOR, OBJECT_RADIUS, triangles

ELEVATIONS = (-22.0, 62.0)  # degrees seen from the object; below -22 the floor would be too near
DISTANCES = (2.75, 3.4)  # object radii: the sphere of radius 1 just fits into FIELD_OF_VIEW at the nearest
FIELD_OF_VIEW = math.radians(43)
CLEARANCE = 0.3  # least distance of a camera from anything, object radii
CLEAR_FRACTION = 0.98  # of the lines to the object's bounding sphere that must meet nothing
TRIES = 400  # of places for one camera


@dataclass(frozen=True)
class Viewpoint:
    """`matrix` is camera-to-world (camera looks down -z, y up)."""

    matrix: Matrix


class Surroundings:
    """The obstacles (everything but the object), for ray casts."""

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
        """Fraction of the straight lines from `position` to the object's bounding sphere that meet nothing.

        A position inside a closed obstacle gets 0, because every line meets the obstacle's wall.
        """
        clear = 0
        for target in self.targets:
            line = target - position
            clear += self.tree.ray_cast(position, line.normalized(), line.length)[0] is None
        return clear / len(self.targets)

    def usable(self, position: Vector) -> bool:
        """Whether a camera may stand there: inside the room, away from obstacles, with a clear view."""
        if not FLOOR + CLEARANCE < position.z < CEILING - CLEARANCE:
            return False
        nearest = self.tree.find_nearest(position)[3]
        return nearest is not None and nearest > CLEARANCE and self.clear_fraction(position) >= CLEAR_FRACTION


def fibonacci_sphere(count: int) -> np.ndarray:
    """[count,3] unit vectors spread evenly over the sphere (golden-angle spiral)."""
    index = np.arange(count) + 0.5
    z = 1 - 2 * index / count
    angle = index * math.pi * (3 - math.sqrt(5))
    ring = np.sqrt(1 - z**2)
    return np.stack([ring * np.cos(angle), ring * np.sin(angle), z], axis=1)


def choose_viewpoints(count: int, surroundings: Surroundings, rng: np.random.Generator) -> list[Viewpoint]:
    """`count` usable viewpoints spread over ELEVATIONS and DISTANCES. ValueError where the scene leaves no place.

    A place that is not usable is moved at random, further with each try.
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
