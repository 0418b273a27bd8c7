"""Builds a scene in the current file of Blender, a random one or one that is named, and chooses its cameras."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import bpy
import numpy as np

from . import scenes
from .photograph import living_room
from .photograph.effects import ROOM, Stage, draws
from .photograph.framing import arranged
from .photograph.object_changes import change_object
from .random_objects import build_object
from .random_scene import TWO_RINGS, SceneDescription, details
from .random_surroundings import build_surroundings
from .turntable import Turntable, build_plate, still_viewpoints, walked
from .viewpoints import Layout, Surroundings, Viewpoint, choose_viewpoints

MARGIN = 1.03
FARTHEST = 1.2
"""The cameras stand at distances from 1 to FARTHEST times the one at which the object's sphere fits into the photo."""


@dataclass
class BuiltScene:
    """A scene that is built, with the poses of its cameras."""

    target: bpy.types.Object
    train: list[Viewpoint]
    test: list[Viewpoint]
    stage: Stage
    turning: Sequence[bpy.types.Object] = ()
    """What turns on a turntable"""


def build_fixed_scene(
    source: str,
    material: str | None,
    seed: int,
    views: tuple[int, int],
    patterned: bool,
    effects: frozenset[str],
    turntable: Turntable | None = None,
) -> BuiltScene:
    """Build the scene in the current file, which must be empty.

    `source`, `material` and `patterned` as in `scenes.build_scene`; `material` None: the object's usual one. `views`: the
    number of photos to learn from, and of test views. `turntable`: how the object turns; None: it stands still. Raises
    ValueError where the scene cannot be built.
    """
    rng = np.random.default_rng(seed)
    material = material or scenes.DEFAULT_MATERIAL.get(source, "gold")
    target, obstacles = scenes.build_scene(source, material, rng, patterned=patterned, alone=ROOM in effects)
    change_object(target, effects, seed)
    stage, surroundings, layout = Stage(scenes.FLOOR, scenes.CEILING, scenes.HALF_WIDTH), None, None
    if ROOM in effects:
        place, support = living_room.describe(seed)
        foot = float(scenes.triangles(target)[0][:, 2].min())
        built = build_surroundings(place, support, foot, draws(seed, ROOM, 1))
        stage, surroundings = built.stage, Surroundings(built.obstacles, built.support)
        layout = Layout(living_room.ELEVATIONS, heights=(-math.inf, math.inf))
    surroundings = surroundings or Surroundings(obstacles)
    if turntable is not None:
        turntable = replace(turntable, printed=turntable.printed or patterned)
        return _on_turntable(target, stage, surroundings, layout, rng, views, turntable)
    train = choose_viewpoints(views[0], surroundings, rng, layout)
    test = choose_viewpoints(views[1], surroundings, rng, layout)
    return BuiltScene(target, arranged(train, effects, seed), test, stage)


def _on_turntable(
    target: bpy.types.Object,
    stage: Stage,
    surroundings: Surroundings,
    layout: Layout | None,
    rng: np.random.Generator,
    views: tuple[int, int],
    turntable: Turntable,
) -> BuiltScene:
    """The scene with a plate below the object. For the test views, the object stands as in the first photo."""
    axis, plate = build_plate(target, rng, turntable.printed)
    train = still_viewpoints(views[0], turntable.rows, axis, surroundings, rng)
    test = choose_viewpoints(views[1], surroundings, rng, layout)
    return BuiltScene(target, walked(train) if turntable.walk else train, test, stage, (target, *plate))


def build_random_scene(scene: SceneDescription, test_views: int, effects: frozenset[str] = frozenset()) -> BuiltScene:
    """Build the scene in the current file, which must be empty. Of the `effects`, `room` is in the description already.

    Raises ValueError where the scene cannot be built, or has no place for a camera.
    """
    target = build_object(scene)
    change_object(target, effects, scene.seed)
    vertices, _ = scenes.triangles(target)
    foot = float(vertices[:, 2].min())
    rng = details(scene.seed, "surroundings")
    built = build_surroundings(scene.place, scene.support, foot, rng)
    surroundings = Surroundings(built.obstacles, built.support)
    layout = layout_of(scene)
    train = choose_viewpoints(scene.cameras.views, surroundings, details(scene.seed, "cameras"), layout)
    test = choose_viewpoints(test_views, surroundings, details(scene.seed, "test cameras"), layout)
    return BuiltScene(target, arranged(train, effects, scene.seed), test, built.stage)


def layout_of(scene: SceneDescription) -> Layout:
    """Where the cameras of the scene may stand. Walls and floors limit the places too."""
    nearest = MARGIN / math.sin(math.radians(scene.cameras.field_of_view) / 2)
    return Layout(
        scene.cameras.elevations, (nearest, FARTHEST * nearest), (-math.inf, math.inf), scene.cameras.kind == TWO_RINGS
    )
