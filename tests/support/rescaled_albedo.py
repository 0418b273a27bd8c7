"""What tests/benchmarks/test_scoring.py checks in Blender. It imports no torch: that would take seconds."""

import sys
from pathlib import Path

import numpy as np


def check_rescaled_albedo():
    import bpy

    from backend.rendering.relight import RelitScene
    from backend.scene_io.capture_files import Frame
    from benchmarks.scoring.relighting import scale_base_color

    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.mesh.primitive_plane_add(size=20)  # it fills the picture
    plane, factors = bpy.context.object, (0.5, 1.0, 1.5)
    material = bpy.data.materials.new("metal")
    material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    bsdf = nodes["Principled BSDF"]
    bsdf.inputs["Metallic"].default_value = 1.0
    bsdf.inputs["Roughness"].default_value = 0.0  # light that scatters twice would count the albedo twice
    albedo = nodes.new("ShaderNodeRGB")
    albedo.outputs[0].default_value = (0.4, 0.4, 0.4, 1.0)
    links.new(albedo.outputs[0], bsdf.inputs["Base Color"])
    plane.data.materials.append(material)
    above = np.eye(4)
    above[2, 3] = 3.0
    frame = Frame(Path("none.png"), 8, 8, 40.0, 40.0, 4.0, 4.0, above, "linear", (1.0, 1.0, 1.0))
    with RelitScene(plane, 8, 8, 16) as scene:
        world = bpy.data.worlds.new("gray")
        before = scene.render(frame, world).mean((0, 1))
        scale_base_color(plane, factors)
        after = scene.render(frame, world).mean((0, 1))
    assert before.min() > 0.01
    np.testing.assert_allclose(after / before, factors, rtol=0.02)


if __name__ == "__main__":
    globals()[sys.argv[1]](*sys.argv[2:])
