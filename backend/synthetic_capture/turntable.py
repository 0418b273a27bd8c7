"""A turntable: the object turns on a plate, while the camera, the lamps and everything else stand still."""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import bmesh
import bpy
import numpy as np
from mathutils import Matrix, Vector

from ..scene_io.image_files import write_whole
from . import scenes
from .viewpoints import DISTANCES, TRIES, Surroundings, Viewpoint

TURNS = "turns.json"
"""The true turns, beside transforms.json"""
LIGHT, LIGHT_ROWS, LIGHT_SAMPLES = "light.exr", 128, 64
"""The true light around the object, beside transforms.json, its rows, and its samples a pixel"""
ELEVATIONS = (14.0, 36.0, 56.0, -8.0)
"""degrees: the height of each row's camera, seen from the object"""
ECCENTRICITY = 0.12
"""Distance of the turning axis from the object's center, in object radii. Nobody puts the object exactly in the middle."""
PLATE_RADIUS, PLATE_THICKNESS, FOOT_RADIUS = 0.8, 0.06, 0.25


@dataclass(frozen=True)
class Turntable:
    """How photos of a turntable are taken."""

    rows: int
    """The photos to learn from are taken in so many rows, each from one height."""
    walk: bool = False
    """The same photos are taken by walking around the object instead."""
    printed: bool = False
    """The plate has a print, although the rest of the room has none."""


def build_plate(
    target: bpy.types.Object, rng: np.random.Generator, patterned: bool = False
) -> tuple[Vector, list[bpy.types.Object]]:
    """Add the plate below the object. Returns a point [3] of the vertical turning axis, and what turns with the object.

    `patterned`: the plate has a print, so that structure from motion finds features that turn with the object.
    """
    angle = rng.uniform(0, 2 * math.pi)
    axis = Vector((ECCENTRICITY * math.cos(angle), ECCENTRICITY * math.sin(angle), 0))
    foot = float(scenes.triangles(target)[0][:, 2].min())
    plate = _disk("plate", axis, foot - PLATE_THICKNESS, foot, PLATE_RADIUS)
    color = rng.uniform(0.15, 0.5, 3)
    plain = scenes.plain("plate", color, 0.6)
    plate.data.materials.append(scenes.printed("print on the plate", rng, moves=True) if patterned else plain)
    stand = _disk("stand", axis, scenes.FLOOR, foot - PLATE_THICKNESS, FOOT_RADIUS)
    stand.data.materials.append(scenes.plain("stand", (0.1, 0.1, 0.1), 0.6))
    return axis, [plate]


def _disk(name: str, axis: Vector, bottom: float, top: float, radius: float) -> bpy.types.Object:
    mesh = bpy.data.meshes.new(name)
    work = bmesh.new()
    bmesh.ops.create_cone(
        work, cap_ends=True, segments=96, radius1=radius, radius2=radius, depth=top - bottom,
        matrix=Matrix.Translation((axis.x, axis.y, (top + bottom) / 2)),
    )  # fmt: skip
    work.to_mesh(mesh)
    work.free()
    item = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(item)
    return item


def still_viewpoints(
    count: int, rows: int, axis: Vector, surroundings: Surroundings, rng: np.random.Generator
) -> list[Viewpoint]:
    """`count` photos in rows: for each row the camera stands still at a height of its own, and the object turns once.

    Each row starts at a turn of its own, the first one at 0. The cameras of all rows stand on about the same side. Raises
    ValueError where the scene has no place for the cameras.
    """
    places = _places(rows, surroundings, rng)
    found = []
    for row, place in enumerate(places):
        photos = count // rows + (row < count % rows)
        start = rng.uniform(0, 2 * math.pi) if row else 0.0
        for photo in range(photos):
            angle = start + 2 * math.pi * photo / photos
            turn = Matrix.Translation(axis) @ Matrix.Rotation(angle, 4, "Z") @ Matrix.Translation(-axis)
            found.append(Viewpoint(place, turn, row))
    return found


def _places(rows: int, surroundings: Surroundings, rng: np.random.Generator) -> list[Matrix]:
    """The pose of each row's camera in the room."""
    for _ in range(TRIES):
        side, places = rng.uniform(0, 2 * math.pi), []
        for elevation in np.radians(ELEVATIONS[:rows]).tolist():
            angle = side + rng.normal(0, 0.1)
            ring = math.cos(elevation)
            position = Vector((ring * math.cos(angle), ring * math.sin(angle), math.sin(elevation))) * rng.uniform(
                *DISTANCES
            )
            if not surroundings.usable(position, (scenes.FLOOR, scenes.CEILING)):
                break
            rotation = (Vector(rng.uniform(-0.06, 0.06, 3).tolist()) - position).to_track_quat("-Z", "Y")
            places.append(Matrix.Translation(position) @ rotation.to_matrix().to_4x4())
        if len(places) == rows:
            return places
    raise ValueError("no free place for a camera in this scene: give another seed")


def walked(viewpoints: Sequence[Viewpoint]) -> list[Viewpoint]:
    """The same photos of the object from the same sides, but taken by walking around the object, which stands still."""
    return [Viewpoint(viewpoint.in_object) for viewpoint in viewpoints]


def turn_to(items: Sequence[bpy.types.Object], viewpoint: Viewpoint) -> None:
    """Turn the items, whose meshes are in the frame of the first turn, as they stand in this photo."""
    for item in items:
        item.matrix_world = viewpoint.turn


def write_turns(folder: Path, viewpoints: Sequence[Viewpoint]) -> None:
    """Write the true turns of the photos, from the object's frame to the room's [4, 4], as `turns.json`. Raises OSError."""
    turns = [[list(row) for row in viewpoint.turn] for viewpoint in viewpoints]
    write_whole(folder / TURNS, (json.dumps({"turns": turns}, indent=1) + "\n").encode())
