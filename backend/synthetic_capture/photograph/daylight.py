"""The light of two days: the windows of the first, and a lamp in the evening of the second."""

import bpy

from .. import scenes
from .effects import Stage

DARK_WINDOW, DIM_LAMP = 0.01, 0.15
"""What is left of windows and sky, and of other lamps, in the evening"""
EVENING_LAMP = ((1.0, 0.55, 0.22), 30.0)
"""(color, strength)"""


class Days:
    """Changes the light of the current scene. All lamps and windows must be there when this is made."""

    def __init__(self, stage: Stage):
        self.lights = []  # (socket, its value by day, its value in the evening)
        for item in bpy.data.objects:
            for material in (slot.material for slot in item.material_slots):
                if material is None or not material.use_nodes:
                    continue
                for node in material.node_tree.nodes:
                    if node.type == "BSDF_PRINCIPLED" and node.inputs["Emission Strength"].default_value > 0:
                        rest = DARK_WINDOW if item.name.startswith("window") else DIM_LAMP
                        self._add(node.inputs["Emission Strength"], rest)
        world = bpy.context.scene.world
        for node in world.node_tree.nodes if world and world.node_tree else ():
            if node.type == "BACKGROUND":
                self._add(node.inputs["Strength"], DARK_WINDOW)
        size, away = 0.14 * stage.half_width, 0.7 * stage.half_width
        height = stage.floor + 0.65 * (stage.ceiling - stage.floor)
        lamp = scenes.box("evening lamp", (away, -away, height), (size, size, size))
        material = scenes.emission(lamp.name, *EVENING_LAMP)
        lamp.data.materials.append(material)
        principled = next(node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
        self.lights.append((principled.inputs["Emission Strength"], 0.0, EVENING_LAMP[1]))

    def _add(self, socket: bpy.types.NodeSocket, rest: float) -> None:
        self.lights.append((socket, socket.default_value, rest * socket.default_value))

    def shine(self, day: int) -> None:
        """Let the light be that of the first day (0), or of the evening of the second (1)."""
        for socket, *values in self.lights:
            if socket.default_value != values[day]:
                socket.default_value = values[day]
