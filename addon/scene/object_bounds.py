"""The object's bounds: a sphere in the scene, an empty that the artist moves and scales, and that the job uses."""

from collections.abc import Sequence
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix, Vector

from ...backend.engine.command import sphere_arguments

NAME = "NeP bounds: {}"
STRETCH_TOLERANCE = 1e-3  # relative difference of the axes up to which an empty counts as a sphere


def bounds_object(scene: bpy.types.Scene) -> bpy.types.Object | None:
    """The empty with the scene's bounds; None where there is none, also where the artist has deleted it."""
    item = scene.nep.bounds
    return item if item is not None and scene in item.users_scene else None


def bounds_arguments(scene: bpy.types.Scene) -> list[str]:
    """The engine's arguments for the scene's bounds. Empty without bounds: then the engine chooses them.

    ValueError where the bounds have no size.
    """
    item = bounds_object(scene)
    if item is None:
        return []
    scene.view_layers[0].update()  # a script may just have moved the empty
    center, radii = _center_and_radii(item)
    if not radii.max() > 0:
        raise ValueError("The object bounds have no size: scale them up, or delete them")
    return sphere_arguments(center.tolist(), radii.max())


def bounds_warning(scene: bpy.types.Scene) -> str:
    """What the artist should know of the shape of the bounds, or an empty string."""
    item = bounds_object(scene)
    if item is None:
        return ""
    _, radii = _center_and_radii(item)
    stretched = radii.min() < (1 - STRETCH_TOLERANCE) * radii.max()
    return "Bounds are stretched: the sphere of the longest axis is used" if stretched else ""


def _center_and_radii(item: bpy.types.Object) -> tuple[np.ndarray, np.ndarray]:
    """Center [3] and radii along the three axes [3] of an empty, in world coordinates, which are the capture's."""
    matrix = np.array(item.matrix_world, np.float64)
    return matrix[:3, 3], np.linalg.norm(matrix[:3, :3], axis=0) * item.empty_display_size


def place_bounds(scene: bpy.types.Scene, capture: Path, center: Sequence[float], radius: float) -> bpy.types.Object:
    """Move the scene's bounds to this sphere (world coordinates), and select them. Returns the empty, which may be new."""
    item = bounds_object(scene)
    if item is None:
        item = bpy.data.objects.new("NeP bounds", None)
        item.empty_display_type, item.empty_display_size = "SPHERE", 1.0
        item.show_in_front = True
        scene.collection.objects.link(item)
        scene.nep.bounds = item
    item.name = NAME.format(capture.resolve().name)
    item.matrix_world = Matrix.LocRotScale(Vector(center), None, Vector([radius / item.empty_display_size] * 3))
    _select_alone(scene, item)
    return item


def _select_alone(scene: bpy.types.Scene, item: bpy.types.Object) -> None:
    """Select the item and nothing else, so that the artist can move it at once. Nobody is thrown out of Edit Mode."""
    layer = scene.view_layers[0]
    active = layer.objects.active
    if (active is not None and active.mode != "OBJECT") or item not in layer.objects.values():
        return
    for other in list(layer.objects.selected):
        other.select_set(False, view_layer=layer)
    item.select_set(True, view_layer=layer)
    layer.objects.active = item
