"""Builds what surrounds the object of a random scene: a room or an HDRI, a support, and things near the object."""

import math
from dataclasses import dataclass, field

import bpy
import numpy as np

from ..scene_io.world import blender_hdris, build_world
from . import scenes
from .photograph import living_room
from .photograph.effects import ROOM_HEIGHT, Stage
from .random_scene import LIVING_ROOM, Place, Support

LEAST_DISTANCE = 3.9
"""Of things that stand on the floor or on poles, in object radii; in a narrow room they stand nearer. Most cameras are
nearer than this, so that few things hide the object."""
THICKNESS = 0.12
"""of a table or a plate"""


FLOOR, CEILING, FAR = -7.0, 18.0, 12.0
"""Without a room: the height of the floor, of a ceiling that only gives people their size, and how far things stand"""
LIVING_ROOM_TABLE = 0.75
"""meters"""


@dataclass
class Built:
    """The meshes around the object."""

    stage: Stage
    support: list[bpy.types.Object] = field(default_factory=list)
    obstacles: list[bpy.types.Object] = field(default_factory=list)
    """all meshes but the object and its support"""


def build_surroundings(place: Place, support: Support, foot: float, rng: np.random.Generator) -> Built:
    """Add the surroundings. `foot` is the height of the object's lowest point, which the support touches.

    Raises ValueError where this Blender has no HDRI of that name.
    """
    stage = _stage(place, support, foot)
    built, floor = Built(stage), stage.floor
    if place.kind == LIVING_ROOM:
        built.obstacles += living_room.build(place, floor, rng)
    elif place.kind == "room":
        built.obstacles += _room(place.half_width, floor, stage.ceiling, rng)
    else:
        _shine(place.hdri, rng)
    if support.kind != "none":
        built.support += _support(support, foot, floor, rng)
    on_table = support.kind == "table" and support.half_width > 2.3
    for number in range(place.things):
        if on_table and number % 2 == 0:
            built.obstacles += _on_table(number, support, foot, rng)
        elif place.kind != LIVING_ROOM:
            built.obstacles += _on_floor(number, place, floor, rng)
    return built


def _stage(place: Place, support: Support, foot: float) -> Stage:
    """The larger the room, the smaller the object in it, and the deeper its floor."""
    if place.kind == LIVING_ROOM:
        meter = place.half_width / living_room.HALF_WIDTH
        floor = foot - LIVING_ROOM_TABLE * meter
        return Stage(floor, floor + ROOM_HEIGHT * meter, place.half_width, support.half_width)
    if place.kind == "room":
        floor = min(-float(np.clip(0.3 * place.half_width, 1.5, 9.0)), foot - 0.4)
        return Stage(floor, floor + max(1.1 * place.half_width, 4.8), place.half_width, support.half_width)
    return Stage(FLOOR, CEILING, FAR, support.half_width)


def _shine(name: str, rng: np.random.Generator) -> None:
    found = {path.stem: path for path in blender_hdris()}
    if name not in found:
        raise ValueError(f"this Blender has no HDRI {name!r}: give another --random seed, or use Blender's own build")
    world = build_world(found[name], name=name, pack=False)
    nodes, links = world.node_tree.nodes, world.node_tree.links
    texture = next(node for node in nodes if node.type == "TEX_ENVIRONMENT")
    coordinates, turn = nodes.new("ShaderNodeTexCoord"), nodes.new("ShaderNodeMapping")
    turn.inputs["Rotation"].default_value = (0, 0, rng.uniform(0, 2 * math.pi))
    links.new(coordinates.outputs["Generated"], turn.inputs["Vector"])
    links.new(turn.outputs["Vector"], texture.inputs["Vector"])
    bpy.context.scene.world = world


def _room(half_width: float, floor: float, ceiling: float, rng: np.random.Generator) -> list[bpy.types.Object]:
    """Walls, floor, ceiling, pictures, a door, windows and lamps. All sizes grow with the room."""
    scale = half_width / 5.2
    middle, height, reach = (floor + ceiling) / 2, ceiling - floor, half_width + 0.05
    parts = [
        _painted(scenes.box("floor", (0, 0, floor - 0.05), (2 * reach, 2 * reach, 0.1)), rng, 1.1 / scale),
        _painted(scenes.box("ceiling", (0, 0, ceiling + 0.05), (2 * reach, 2 * reach, 0.1)), rng, pale=True),
    ]
    for number, (x, y) in enumerate(((1, 0), (-1, 0), (0, 1), (0, -1))):
        size = (0.1, 2 * reach, height) if x else (2 * reach, 0.1, height)
        wall = scenes.box(f"wall{number}", (x * reach, y * reach, middle), size)
        pale = rng.random() < 0.4
        parts.append(_painted(wall, rng, 0 if pale else (0, 0.7 / scale)[number % 2], pale))
        for k in range(int(rng.integers(1, 4))):  # pictures and doors give detail that reflections can show
            width, tall = rng.uniform(0.15, 0.4, 2) * (half_width, height)
            along, up = rng.uniform(-0.7, 0.7) * half_width, floor + rng.uniform(0.3, 0.7) * height
            place, shape = (along, y * (half_width - 0.01 * scale)), (width, 0.04 * scale)
            place, shape = ((x * (half_width - 0.01 * scale), along), shape[::-1]) if x else (place, shape)
            picture = scenes.box(f"picture{number}.{k}", (*place, up), (*shape, tall))
            parts.append(_painted(picture, rng, (0, 6.0 / scale)[k % 2]))
    for number, (place, size, color, strength) in enumerate(_lamps(half_width, floor, ceiling, rng)):
        lamp = scenes.box(f"lamp{number}", place, size)
        lamp.data.materials.append(scenes.emission(lamp.name, color, strength))
        parts.append(lamp)
    return parts


def _lamps(half_width: float, floor: float, ceiling: float, rng: np.random.Generator) -> list[tuple]:
    """(place, size, color, strength) of a window and of one to three lamps below the ceiling."""
    scale, height = half_width / 5.2, ceiling - floor
    window = (
        (-half_width + 0.03 * scale, rng.uniform(-0.4, 0.4) * half_width, floor + 0.55 * height),
        (0.05 * scale, rng.uniform(2.2, 3.6) * scale, 0.4 * height),
        (0.85, 0.93, 1.0),
        rng.uniform(5, 10),
    )
    lamps = [window]
    for _ in range(int(rng.integers(1, 4))):
        x, y = rng.uniform(-0.6, 0.6, 2) * half_width
        size = (rng.uniform(0.8, 2.0) * scale, rng.uniform(0.6, 1.4) * scale, 0.05 * scale)
        lamps.append(((x, y, ceiling - 0.04 * scale), size, (1.0, rng.uniform(0.85, 1), rng.uniform(0.65, 0.95)), 18.0))
    return lamps


def _support(support: Support, foot: float, floor: float, rng: np.random.Generator) -> list[bpy.types.Object]:
    """A table or a plate whose upper side is at the height `foot`, and its leg, which reaches the floor."""
    width, middle = 2 * support.half_width, foot - THICKNESS / 2
    if support.round:
        bpy.ops.mesh.primitive_cylinder_add(
            vertices=128, radius=support.half_width, depth=THICKNESS, location=(0, 0, middle)
        )
        top = bpy.context.object
        _smooth(top)
    else:
        top = scenes.box("support", (0, 0, middle), (width, width * rng.uniform(0.7, 1), THICKNESS))
        top.rotation_euler.z = rng.uniform(0, math.pi)
    top.name = "support"
    checker = rng.uniform(1.5, 6) if support.pattern else 0
    top.data.materials.append(scenes.surface("support", rng, support.roughness, checker))
    height, radius = foot - THICKNESS - floor, 0.2 * support.half_width
    bpy.ops.mesh.primitive_cylinder_add(vertices=48, radius=radius, depth=height, location=(0, 0, floor + height / 2))
    leg = bpy.context.object
    _smooth(leg)
    return [top, _painted(leg, rng)]


def _on_table(number: int, support: Support, foot: float, rng: np.random.Generator) -> list[bpy.types.Object]:
    """A small thing that stands on the table beside the object's sphere; nothing where it would stand over the edge."""
    size = rng.uniform(0.12, 0.3)
    reach = support.half_width * (1.0 if support.round else 0.7) - size
    low = 1.35 + size
    if reach < low:
        return []
    distance, angle = rng.uniform(low, reach), number * 2.399963 + rng.uniform(-0.3, 0.3)
    x, y = distance * math.cos(angle), distance * math.sin(angle)
    return [_thing(f"thing{number}", (x, y, foot), size, angle, rng)]


def _on_floor(number: int, place: Place, floor: float, rng: np.random.Generator) -> list[bpy.types.Object]:
    """A thing on a pole at about the height of the object, or a column. The things farther away are larger."""
    farthest = min(max(0.8 * place.half_width, 4.2), 16.0) if place.half_width else 12.0
    nearest = min(LEAST_DISTANCE, 0.8 * farthest)
    distance, angle = rng.uniform(nearest, farthest), number * 2.399963 + rng.uniform(-0.4, 0.4)
    size = distance * rng.uniform(0.06, 0.14)
    if place.half_width:  # the thing stays inside the room
        distance = min(distance, place.half_width - 1.5 * size)
    x, y = distance * math.cos(angle), distance * math.sin(angle)
    if number % 3 == 2:
        height = -floor + rng.uniform(-0.5, 1.5) * size
        return [_thing(f"thing{number}", (x, y, floor), size, angle, rng, height)]
    up = rng.uniform(-0.35, 0.2) * distance
    up = max(up, floor + 0.1)
    pole = scenes.box(f"pole{number}", (x, y, (floor + up) / 2), (0.3 * size, 0.3 * size, up - floor))
    return [_painted(pole, rng), _thing(f"thing{number}", (x, y, up), size, angle, rng)]


def _thing(
    name: str,
    foot: tuple[float, float, float],
    size: float,
    angle: float,
    rng: np.random.Generator,
    height: float | None = None,
) -> bpy.types.Object:
    """A box or a ball that stands at the place `foot`; a column of that height where `height` is given."""
    x, y, z = foot
    if height is not None:
        bpy.ops.mesh.primitive_cylinder_add(vertices=48, radius=size, depth=height, location=(x, y, z + height / 2))
        item = bpy.context.object
        _smooth(item)
    elif rng.random() < 0.5:
        bpy.ops.mesh.primitive_uv_sphere_add(segments=48, ring_count=24, radius=size, location=(x, y, z + size))
        item = bpy.context.object
        _smooth(item)
    else:
        item = scenes.box(name, (x, y, z + size), (2 * size, 1.6 * size, 2 * size))
        item.rotation_euler.z = angle
    item.name = name
    return _painted(item, rng, (0, 3.5 / size)[int(rng.random() < 0.5)])


def _painted(item: bpy.types.Object, rng: np.random.Generator, checker: float = 0, pale: bool = False) -> bpy.types.Object:
    item.data.materials.append(scenes.surface(item.name, rng, rng.uniform(0.3, 0.8), checker, pale))
    return item


def _smooth(item: bpy.types.Object) -> None:
    item.data.shade_smooth()
    item.data.set_sharp_from_angle(angle=math.radians(40))
