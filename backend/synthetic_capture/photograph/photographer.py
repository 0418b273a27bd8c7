"""The person who takes the photos: body, head, arms, and the phone. The object mirrors the person, who throws a shadow.

The camera itself does not see the person. Lengths are in meters here, until `Stage.meter` makes object radii of them.
"""

import math

import bpy
from mathutils import Matrix, Vector

from .. import scenes
from .effects import Stage

HEAD_BEHIND = 0.32
"""from the camera to the head"""
TALLEST, STANDING_HIPS = 1.72, 0.95
"""highest place of the head's center, and of the hips, above the floor"""
LOWEST_HEAD, LOWEST_HIPS = 0.75, 0.25
"""of somebody who squats"""
TORSO, SHOULDERS, HIPS, LEG = 0.55, 0.2, 0.1, 0.44
"""from neck to hips; half the width of shoulders and hips; half of a leg"""
FARTHEST_LEAN = 0.55
"""how far the hips may be behind the neck"""
TABLE_GAP = 0.12
"""from the edge of the table to the hips"""
PARTS = {
    "cloth": ((0.03, 0.035, 0.06), 0.8),
    "trousers": ((0.06, 0.05, 0.045), 0.8),
    "skin": ((0.5, 0.3, 0.21), 0.45),
    "hair": ((0.03, 0.02, 0.015), 0.5),
    "phone": ((0.015, 0.015, 0.017), 0.2),
}
"""Name -> (Base Color, roughness)"""


class Photographer:
    """Meshes in the current scene that stand as a person does behind a camera."""

    def __init__(self, stage: Stage):
        self.stage = stage
        self.materials = {name: scenes.plain(f"photographer {name}", *look) for name, look in PARTS.items()}
        bpy.ops.mesh.primitive_uv_sphere_add(segments=32, ring_count=16, radius=1)
        ball = bpy.context.object
        bpy.ops.mesh.primitive_cylinder_add(vertices=32, radius=1, depth=1)
        tube = bpy.context.object
        box = scenes.box("photographer box", (0, 0, 0), (1, 1, 1))
        self.models = {"ball": ball.data, "tube": tube.data, "box": box.data}
        for model in (ball, tube):
            model.data.shade_smooth()
            model.data.set_sharp_from_angle(angle=math.radians(40))
        for model in (ball, tube, box):
            model.data.materials.append(None)  # each object brings its own material
            bpy.data.objects.remove(model)
        self.items: list[bpy.types.Object] = []

    def hide(self) -> None:
        """Nobody is in the scene."""
        for item in self.items:
            item.hide_render = True

    def stand_behind(self, camera: Matrix) -> None:
        """Stand behind the camera with this camera-to-world matrix, which looks down -z."""
        shapes = self._shapes(camera)
        while len(self.items) < len(shapes):
            item = bpy.data.objects.new("photographer", self.models["ball"])
            item.visible_camera = False
            bpy.context.scene.collection.objects.link(item)
            self.items.append(item)
        for item, (model, material, matrix) in zip(self.items, shapes, strict=True):
            item.data, item.hide_render = self.models[model], False
            item.material_slots[0].link = "OBJECT"
            item.material_slots[0].material = self.materials[material]
            item.matrix_world = matrix

    def _shapes(self, camera: Matrix) -> list[tuple[str, str, Matrix]]:
        """(model, material, matrix) of each part of the person."""
        meter, floor = self.stage.meter, self.stage.floor / self.stage.meter
        place, back = camera.translation / meter, camera.to_3x3().col[2].normalized()
        across = camera.to_3x3().col[0].normalized()
        outward = Vector((back.x, back.y, 0))
        outward = outward.normalized() if outward.length > 1e-3 else Vector((1, 0, 0))
        right = Vector((-outward.y, outward.x, 0))
        head = place + HEAD_BEHIND * back
        head.z = min(max(head.z, floor + LOWEST_HEAD), floor + TALLEST)
        neck = head + 0.04 * outward - Vector((0, 0, 0.19))
        lean = min(max(0.05, self.stage.table / meter + TABLE_GAP - neck.dot(outward)), FARTHEST_LEAN)
        low = math.sqrt(max(TORSO**2 - lean**2, 0.01))
        hips = neck + lean * outward
        hips.z = max(min(neck.z - low, floor + STANDING_HIPS), floor + LOWEST_HIPS)
        phone = camera.copy()
        phone.translation = place + 0.012 * back
        shapes = [
            ("ball", "skin", _placed(head, (0.08, 0.1, 0.12), outward)),
            ("ball", "hair", _placed(head + 0.025 * outward + Vector((0, 0, 0.025)), (0.09, 0.1, 0.12), outward)),
            ("tube", "skin", _tube(head, neck, 0.055)),
            ("box", "phone", phone @ Matrix.Diagonal((0.16, 0.08, 0.009, 1))),
            *_limb("cloth", 0.15, neck - 0.1 * (neck - hips).normalized(), hips),
            *_limb("cloth", 0.06, neck + SHOULDERS * right, neck - SHOULDERS * right),
        ]
        for side in (-1, 1):
            shoulder, hand = neck + side * SHOULDERS * right, place + 0.02 * back
            hand = hand + (1 if across.dot(right) * side > 0 else -1) * 0.09 * across
            elbow = (shoulder + hand) / 2 + side * 0.09 * right - Vector((0, 0, 0.13))
            shapes += [*_limb("cloth", 0.05, shoulder, elbow), *_limb("cloth", 0.042, elbow, hand)]
            shapes.append(("ball", "skin", _placed(hand, (0.045, 0.045, 0.045), outward)))
            hip = hips + side * HIPS * right
            foot = Vector((hip.x, hip.y, floor + 0.05))
            straight = (hip.z - foot.z) / 2
            knee = (hip + foot) / 2 - math.sqrt(max(LEG**2 - straight**2, 0)) * outward + 0.03 * side * right
            shapes += [*_limb("trousers", 0.085, hip, knee), *_limb("trousers", 0.065, knee, foot)]
        return [(model, material, Matrix.Scale(meter, 4) @ matrix) for model, material, matrix in shapes]


def _limb(material: str, radius: float, *ends: Vector) -> list[tuple[str, str, Matrix]]:
    """A round limb between two places."""
    balls = [("ball", material, _placed(end, (radius,) * 3, Vector((1, 0, 0)))) for end in ends]
    return [("tube", material, _tube(*ends, radius)), *balls]


def _tube(start: Vector, end: Vector, radius: float) -> Matrix:
    """The matrix of a cylinder of radius 1 and height 1."""
    along = end - start
    turn = along.to_track_quat("Z", "Y").to_matrix().to_4x4()
    return Matrix.Translation((start + end) / 2) @ turn @ Matrix.Diagonal((radius, radius, along.length, 1))


def _placed(place: Vector, size: tuple[float, float, float], outward: Vector) -> Matrix:
    """The matrix of a ball of radius 1 whose x axis is horizontal and points outward."""
    turn = Matrix.Rotation(math.atan2(outward.y, outward.x), 4, "Z")
    return Matrix.Translation(place) @ turn @ Matrix.Diagonal((*size, 1))
