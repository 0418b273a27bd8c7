"""The object's bounds: a sphere in the viewport that the artist moves and scales, and that the job uses."""

from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix, Vector

from ..backend.engine.bounds_query import BoundsQuery
from ..backend.scene_io.capture_files import read_bounds
from . import clock
from .preferences import engine_python
from .settings import NOT_SAVED
from .settings import folder as folder_of

NAME = "NeP bounds: {}"
STRETCH_TOLERANCE = 1e-3

query = None  # the BoundsTask under way
last_message = ""  # how the last one ended, where it failed


def bounds_object(scene):
    """The scene's bounds; None where there are none (also when they were deleted)."""
    item = scene.nep.bounds
    return item if item is not None and scene.objects.get(item.name) == item else None


def sphere(scene) -> tuple[list[float], float, str] | None:
    """(centre [3], radius, a remark or '') in world coordinates, which are the capture's; None without bounds.

    A stretched or mirrored empty counts as the sphere of its longest axis, and the remark says so.
    """
    item = bounds_object(scene)
    if item is None:
        return None
    matrix = np.array(item.matrix_world, np.float64)
    axes = np.linalg.norm(matrix[:3, :3], axis=0) * item.empty_display_size
    stretched = axes.min() < (1 - STRETCH_TOLERANCE) * axes.max()
    remark = "Bounds are stretched: the sphere of the longest axis is used" if stretched else ""
    return matrix[:3, 3].tolist(), float(axes.max()), remark


def bounds_arguments(scene) -> list[str]:
    """The engine's arguments for the scene's bounds; none without bounds: then the engine chooses.

    ValueError where the bounds have no size.
    """
    if bounds_object(scene) is None:
        return []
    scene.view_layers[0].update()  # a script may just have moved the empty
    center, radius, _ = sphere(scene)
    if not radius > 0:
        raise ValueError("The object bounds have no size: scale them up, or delete them")
    # positional notation: argparse takes -1e-05 for an option
    numbers = [np.format_float_positional(value, trim="0") for value in (*center, radius)]
    return ["--object-center", *numbers[:3], "--object-radius", numbers[3]]


def bounds_remark(scene) -> str:
    """What the artist should know of the bounds' shape, or ''."""
    found = sphere(scene)
    return found[2] if found else ""


def place_bounds(scene, capture: Path, center, radius: float):
    """Put the scene's bounds there; makes them where there are none."""
    item = bounds_object(scene)
    if item is None:
        item = bpy.data.objects.new("NeP bounds", None)
        item.empty_display_type, item.empty_display_size = "SPHERE", 1.0
        item.show_in_front = True
        scene.collection.objects.link(item)
        scene.nep.bounds = item
    item.name = NAME.format(capture.resolve().name)
    item.matrix_world = Matrix.LocRotScale(Vector(center), None, Vector([radius / item.empty_display_size] * 3))
    return item


class BoundsTask:
    """The engine's estimate on its way into a scene."""

    def __init__(self, scene, capture: Path, configured_python: str):
        self.scene, self.capture = scene.name, capture
        self._asked = BoundsQuery(capture, configured_python)
        self.poll, self.close = self._asked.poll, self._asked.close

    def shown(self) -> None:
        """The panel tells nothing of it but that it runs."""

    def finish(self) -> None:
        global query, last_message
        query, last_message = None, self._asked.error
        scene = bpy.data.scenes.get(self.scene)
        if self._asked.sphere is None or scene is None or folder_of(scene.nep.capture) != self.capture:
            return  # none found, or another file or another choice by now
        place_bounds(scene, self.capture, *self._asked.sphere)
        if not bpy.app.background:
            bpy.ops.ed.undo_push(message="Propose Bounds")


def end_query() -> None:
    """Forget the question under way, if any."""
    global query, last_message
    if query is not None:
        query.close()
    query, last_message = None, ""


class NEP_OT_propose_bounds(bpy.types.Operator):
    bl_idname = "nep.propose_bounds"
    bl_label = "Propose Bounds"
    bl_description = (
        "Put a sphere around the object: the capture's own, or an estimate from its cameras and masks. "
        "Then move and scale it until the whole object is inside, and no camera"
    )
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context):
        if query is not None:
            cls.poll_message_set("The bounds are being estimated")
            return False
        if not context.scene.nep.capture:
            cls.poll_message_set("Choose a capture folder first")
            return False
        return True

    def invoke(self, context, event):
        return self._propose(context, wait=bpy.app.background)

    def execute(self, context):
        return self._propose(context, wait=True)

    def _propose(self, context, wait: bool):
        global query, last_message
        scene, last_message = context.scene, ""
        capture = folder_of(scene.nep.capture)
        if capture is None:
            self.report({"ERROR"}, NOT_SAVED)
            return {"CANCELLED"}
        try:
            known = read_bounds(capture)
        except (OSError, ValueError) as error:
            self.report({"ERROR"}, f"The capture cannot be read: {error}")
            return {"CANCELLED"}
        if known:
            place_bounds(scene, capture, *known)
            self.report({"INFO"}, "Bounds of transforms.json")
            return {"FINISHED"}
        query = BoundsTask(scene, capture, engine_python(context))
        clock.look_after(query, wait=wait)
        if not wait:
            return {"FINISHED"}
        if last_message:
            self.report({"ERROR"}, last_message)
            return {"CANCELLED"}
        self.report({"INFO"}, "Bounds estimated from the photos")
        return {"FINISHED"}


class NEP_OT_clear_bounds(bpy.types.Operator):
    bl_idname = "nep.clear_bounds"
    bl_label = "Clear Bounds"
    bl_description = "Remove the object bounds: the engine then chooses them itself"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context):
        if bounds_object(context.scene) is None:
            cls.poll_message_set("There are no object bounds")
            return False
        return True

    def execute(self, context):
        bpy.data.objects.remove(context.scene.nep.bounds)
        return {"FINISHED"}


CLASSES = (NEP_OT_propose_bounds, NEP_OT_clear_bounds)
