"""Builds a random scene in the current file of Blender, and chooses its cameras."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import bpy

from . import scenes
from .photograph.effects import Stage
from .random_objects import build_object
from .random_scene import TWO_RINGS, SceneDescription, details
from .random_surroundings import build_surroundings
from .viewpoints import Layout, Surroundings, Viewpoint, choose_viewpoints

MARGIN = 1.03
FARTHEST = 1.2
"""The cameras stand at distances from 1 to FARTHEST times the one at which the object's sphere fits into the photo."""


@dataclass
class RandomScene:
    """A scene that is built, with the poses of its cameras."""

    target: bpy.types.Object
    train: list[Viewpoint]
    test: list[Viewpoint]
    stage: Stage


def build_random_scene(
    scene: SceneDescription, test_views: int, change_object: Callable[[bpy.types.Object], None] | None = None
) -> RandomScene:
    """Build the scene in the current file, which must be empty.

    `change_object` is called with the object before anything else is built. Raises ValueError where the scene cannot be
    built, or has no place for a camera.
    """
    target = build_object(scene)
    if change_object:
        change_object(target)
    vertices, _ = scenes.triangles(target)
    foot = float(vertices[:, 2].min())
    rng = details(scene.seed, "surroundings")
    built = build_surroundings(scene.place, scene.support, foot, rng)
    surroundings = Surroundings(built.obstacles, built.support)
    layout = layout_of(scene)
    train = choose_viewpoints(scene.cameras.views, surroundings, details(scene.seed, "cameras"), layout)
    test = choose_viewpoints(test_views, surroundings, details(scene.seed, "test cameras"), layout)
    return RandomScene(target, train, test, built.stage)


def layout_of(scene: SceneDescription) -> Layout:
    """Where the cameras of the scene may stand. Walls and floors limit the places too."""
    nearest = MARGIN / math.sin(math.radians(scene.cameras.field_of_view) / 2)
    return Layout(
        scene.cameras.elevations, (nearest, FARTHEST * nearest), (-math.inf, math.inf), scene.cameras.kind == TWO_RINGS
    )
