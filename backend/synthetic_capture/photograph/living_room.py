"""A room as people live in: bright windows, a lamp, and furniture along the walls. The object stands on a table in it.

Lengths are in meters here, and heights are above the floor, until the room's size makes object radii of them.
"""

from dataclasses import replace

import bpy
import numpy as np

from .. import scenes
from ..random_scene import LIVING_ROOM, UPPER_HALF, Place, SceneDescription, Support
from .effects import ROOM, ROOM_HEIGHT, draws

HALF_WIDTH, TABLE = 2.5, (0.2, 0.45)
"""of the room, and the limits of that of its round table"""
RADII = (20.0, 60.0)
"""limits of the room's half width, in object radii"""
ELEVATIONS = (26.0, 65.0)
"""degrees; no photo shows anything above the object then"""
THINGS = 4
WALL = HALF_WIDTH - 0.02
# Name -> (middle, size, look). A look is a color, 'print' or 'pale'.
FURNITURE = {
    "carpet": ((0, 0, 0.006), (3.2, 2.4, 0.012), "print"),
    "sofa seat": ((2.0, 0.3, 0.22), (0.9, 1.9, 0.44), (0.12, 0.2, 0.24)),
    "sofa back": ((2.36, 0.3, 0.45), (0.22, 1.9, 0.9), (0.12, 0.2, 0.24)),
    "sofa arm": ((2.0, 1.3, 0.3), (0.9, 0.16, 0.6), (0.12, 0.2, 0.24)),
    "cushion": ((2.1, -0.3, 0.6), (0.2, 0.5, 0.4), "print"),
    "cupboard": ((-1.1, 2.22, 0.95), (1.2, 0.5, 1.9), (0.3, 0.17, 0.08)),
    "cupboard door": ((-0.81, 1.96, 1.0), (0.55, 0.02, 1.6), (0.38, 0.22, 0.11)),
    "books": ((1.1, -2.32, 0.9), (1.1, 0.3, 1.8), "print"),
    "shelf": ((1.1, -2.35, 0.9), (1.2, 0.26, 1.9), (0.6, 0.55, 0.48)),
    "sideboard": ((-2.2, -1.0, 0.36), (0.45, 1.5, 0.72), (0.45, 0.42, 0.36)),
    "television": ((-2.15, -1.0, 1.02), (0.06, 1.0, 0.58), (0.01, 0.01, 0.012)),
    "chair seat": ((1.25, -0.95, 0.45), (0.45, 0.45, 0.05), (0.35, 0.2, 0.09)),
    "chair back": ((1.44, -0.95, 0.72), (0.05, 0.45, 0.5), (0.35, 0.2, 0.09)),
    "chair leg": ((1.25, -0.95, 0.21), (0.38, 0.38, 0.42), (0.2, 0.11, 0.05)),
    "door": ((-1.5, -WALL, 1.0), (0.9, 0.06, 2.0), (0.62, 0.6, 0.55)),
    "heater": ((-2.42, 1.0, 0.4), (0.1, 1.0, 0.6), "pale"),
    "picture 0": ((0.2, WALL, 1.5), (0.7, 0.04, 0.5), "print"),
    "picture 1": ((WALL, -1.5, 1.4), (0.04, 0.8, 0.6), "print"),
    "curtain 0": ((-2.43, 0.2, 1.25), (0.06, 0.25, 2.2), (0.45, 0.1, 0.07)),
    "curtain 1": ((-2.43, 1.85, 1.25), (0.06, 0.25, 2.2), (0.45, 0.1, 0.07)),
}
WINDOWS = (
    ((-WALL, 1.0, 1.55), (0.04, 1.3, 1.3)),
    ((-WALL, -1.2, 1.75), (0.04, 1.0, 0.9)),
    ((1.4, WALL, 1.55), (1.1, 0.04, 1.3)),
)
"""(middle, size)"""
DAYLIGHT, LAMPLIGHT = ((0.85, 0.93, 1.0), 14.0), ((1.0, 0.86, 0.68), 8.0)
"""(color, strength)"""
LAMP = ((0.3, 0.2, ROOM_HEIGHT - 0.1), (0.55, 0.55, 0.1))


def describe(seed: int) -> tuple[Place, Support]:
    """The room and the table that a seed draws."""
    rng = draws(seed, ROOM)
    half_width = round(float(np.exp(rng.uniform(*np.log(RADII)))), 2)
    table = round(float(rng.uniform(*TABLE)) / HALF_WIDTH * half_width, 3)
    return Place(LIVING_ROOM, half_width, None, THINGS), Support("table", table, True, 0.35, bool(rng.random() < 0.7))


def in_living_room(scene: SceneDescription) -> SceneDescription:
    """The scene in a room and on a table that its seed draws, with cameras that look down."""
    place, support = describe(scene.seed)
    cameras = replace(scene.cameras, kind=UPPER_HALF, elevations=ELEVATIONS)
    return replace(scene, place=place, support=support, cameras=cameras)


def build(place: Place, floor: float, rng: np.random.Generator) -> list[bpy.types.Object]:
    """Add walls, windows, a lamp and furniture. `floor` is the height of the floor in object radii."""
    meter = place.half_width / HALF_WIDTH

    def add(name: str, middle: tuple, size: tuple) -> bpy.types.Object:
        x, y, z = (meter * length for length in middle)
        return scenes.box(name, (x, y, floor + z), [meter * length for length in size])

    parts, width, wall = [], 2 * HALF_WIDTH, HALF_WIDTH + 0.05
    walls = {
        "floor": ((0, 0, -0.05), (width, width, 0.1), (0.3, 0.2, 0.12)),
        "ceiling": ((0, 0, ROOM_HEIGHT + 0.05), (width, width, 0.1), "pale"),
        "wall 0": ((wall, 0, ROOM_HEIGHT / 2), (0.1, width, ROOM_HEIGHT), "pale"),
        "wall 1": ((-wall, 0, ROOM_HEIGHT / 2), (0.1, width, ROOM_HEIGHT), (0.6, 0.58, 0.5)),
        "wall 2": ((0, wall, ROOM_HEIGHT / 2), (width, 0.1, ROOM_HEIGHT), "pale"),
        "wall 3": ((0, -wall, ROOM_HEIGHT / 2), (width, 0.1, ROOM_HEIGHT), (0.42, 0.5, 0.52)),
    }
    for name, (middle, size, look) in (walls | FURNITURE).items():
        parts.append(add(name, middle, size))
        parts[-1].data.materials.append(_material(name, look, meter, rng))
    for number, (middle, size) in enumerate(WINDOWS):
        parts.append(add(f"window{number}", middle, size))
        parts[-1].data.materials.append(scenes.emission(f"window{number}", *DAYLIGHT))
        bar = [0.09 if length == 0.04 else 0.06 for length in size]
        for axis in (0, 1, 2):
            if size[axis] != 0.04:
                beam = [size[k] if k == axis else bar[k] for k in range(3)]
                parts.append(add(f"bar{number}.{axis}", middle, beam))
                parts[-1].data.materials.append(scenes.surface("bar", rng, 0.5, pale=True))
    parts.append(add("ceiling lamp", *LAMP))
    parts[-1].data.materials.append(scenes.emission("ceiling lamp", *LAMPLIGHT))
    return parts


def _material(name: str, look: object, meter: float, rng: np.random.Generator) -> bpy.types.Material:
    if look == "print":
        return scenes.printed(name, rng, 8 / meter)
    if isinstance(look, tuple):
        return scenes.plain(name, look, 0.15 if name == "television" else 0.55)
    return scenes.surface(name, rng, 0.6, pale=True)
