"""Changes of the object itself: a long one in its sphere, and materials as things have them, several on one object."""

import bpy
import numpy as np
from mathutils import Matrix

from .. import scenes
from ..random_objects import resting_pose
from ..substances import Substance
from .effects import LONG, MATERIALS, draws

THICKNESS = 0.3
"""of a long object, as a part of its length"""
BRASS, TARNISH = Substance((0.72, 0.52, 0.24), 0.3, 1.0), Substance((0.42, 0.28, 0.13), 0.6, 1.0)
PATINA = Substance((0.13, 0.3, 0.24), 0.75, 0.0)
PLASTIC = Substance((0.025, 0.025, 0.027), 0.4, 0.0)
WOOD, GRAIN = Substance((0.3, 0.12, 0.045), 0.14, 0.0), Substance((0.13, 0.045, 0.02), 0.14, 0.0)
SUBSTANCES = (BRASS, TARNISH, PATINA, PLASTIC, WOOD, GRAIN)
BRASS_SHARE, PLASTIC_SHARE = 0.45, 0.68
"""A cell of the object whose random number, 0..1, is below the first is brass; plastic below the second; above it wood."""


def change_object(target: bpy.types.Object, effects: frozenset[str], seed: int) -> None:
    """Change the object as the effects say. It fits into its sphere again."""
    if LONG in effects:
        stretch(target)
        target.data.transform(resting_pose(target))  # on end it would fall over
        target.data.update()
        scenes.normalize(target)
    if MATERIALS in effects:
        target.data.materials.clear()
        target.data.materials.append(things_material(draws(seed, MATERIALS)))


def stretch(target: bpy.types.Object) -> None:
    """Make the object long along the axis along which it is longest. The sphere is much larger then than it is thick."""
    vertices, _ = scenes.triangles(target)
    extent = np.ptp(vertices, axis=0)
    longest = int(extent.argmax())
    thickest = max(length for axis, length in enumerate(extent) if axis != longest)
    scale = [1.0] * 3
    scale[longest] = max(1.0, float(thickest / (THICKNESS * extent[longest])))
    target.data.transform(Matrix.Diagonal((*scale, 1)))
    target.data.update()
    scenes.normalize(target)


def things_material(rng: np.random.Generator) -> bpy.types.Material:
    """Cells of brass, black plastic and lacquered wood. The brass is tarnished here and there, and green with patina."""
    material, nodes, links = scenes.new_material("object")
    place = nodes.new("ShaderNodeVectorMath")
    place.inputs[1].default_value = rng.uniform(-10, 10, 3)
    links.new(nodes.new("ShaderNodeTexCoord").outputs["Object"], place.inputs[0])

    def node(kind: str, source: bpy.types.NodeSocket, **inputs: float) -> bpy.types.Node:
        made = nodes.new(kind)
        links.new(source, made.inputs["Vector"])
        for name, value in inputs.items():
            made.inputs[name].default_value = value
        return made

    def ramp(value: bpy.types.NodeSocket, low: float, high: float) -> bpy.types.NodeSocket:
        """0 below `low`, 1 above `high`, linear between."""
        made = nodes.new("ShaderNodeMapRange")
        made.inputs["From Min"].default_value, made.inputs["From Max"].default_value = low, high
        links.new(value, made.inputs["Value"])
        return made.outputs["Result"]

    cells = node("ShaderNodeTexVoronoi", place.outputs[0], Scale=2.0)
    number = nodes.new("ShaderNodeSeparateXYZ")
    links.new(cells.outputs["Color"], number.inputs[0])
    noise = node("ShaderNodeTexNoise", place.outputs[0], Scale=2.5, Detail=4.0).outputs[0]
    tarnish = ramp(noise, 0.38, 0.62)
    patina = ramp(node("ShaderNodeTexNoise", place.outputs[0], Scale=4.0, Detail=6.0).outputs[0], 0.58, 0.64)
    stretched = node("ShaderNodeMapping", place.outputs[0], Scale=(9.0, 9.0, 1.2)).outputs[0]
    grain = ramp(node("ShaderNodeTexNoise", stretched, Scale=1.5, Detail=3.0).outputs[0], 0.4, 0.6)
    is_plastic = ramp(number.outputs[0], BRASS_SHARE, BRASS_SHARE + 1e-4)
    is_wood = ramp(number.outputs[0], PLASTIC_SHARE, PLASTIC_SHARE + 1e-4)

    def property_of(values: dict[Substance, tuple]) -> bpy.types.NodeSocket:
        brass = scenes.blend(nodes, links, tarnish, values[BRASS], values[TARNISH])
        brass = scenes.blend(nodes, links, patina, brass, values[PATINA])
        wood = scenes.blend(nodes, links, grain, values[WOOD], values[GRAIN])
        return scenes.blend(nodes, links, is_wood, scenes.blend(nodes, links, is_plastic, brass, values[PLASTIC]), wood)

    sockets = {
        "albedo": property_of({part: part.color for part in SUBSTANCES}),
        "roughness": property_of({part: (part.roughness,) * 3 for part in SUBSTANCES}),
        "metallic": property_of({part: (part.metallic,) * 3 for part in SUBSTANCES}),
    }
    scenes.link_with_truth(nodes, links, sockets)
    return material
