"""Builds the scene that `synthetic.py --scene` names, and chooses its cameras."""

import math
from dataclasses import dataclass

import bpy
import numpy as np

from . import scenes
from .photograph import living_room
from .photograph.effects import ROOM, Stage, draws
from .photograph.framing import arranged
from .photograph.object_changes import change_object
from .random_surroundings import build_surroundings
from .viewpoints import Layout, Surroundings, Viewpoint, choose_viewpoints


@dataclass
class FixedScene:
    """A scene that is built, with the poses of its cameras."""

    target: bpy.types.Object
    train: list[Viewpoint]
    test: list[Viewpoint]
    stage: Stage


def build_fixed_scene(
    source: str, material: str | None, seed: int, views: tuple[int, int], patterned: bool, effects: frozenset[str]
) -> FixedScene:
    """Build the scene in the current file, which must be empty.

    `source`, `material` and `patterned` as in `scenes.build_scene`; `material` None: the object's usual one. `views`: the
    number of photos to learn from, and of test views. Raises ValueError where the scene cannot be built.
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
    train = choose_viewpoints(views[0], surroundings, rng, layout)
    test = choose_viewpoints(views[1], surroundings, rng, layout)
    return FixedScene(target, arranged(train, effects, seed), test, stage)
