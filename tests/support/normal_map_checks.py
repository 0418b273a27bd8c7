"""What tests/surface/test_normal_map.py checks in Blender. It imports no torch: that would take seconds."""

import sys
import tempfile
from pathlib import Path

import numpy as np

SIZE = 128
"""Width and height in pixels of the pictures by Cycles"""


def angles(a, b):
    """Angles [n] in degrees between vectors [n, 3]."""
    cosine = (a * b).sum(1) / np.linalg.norm(a, axis=1) / np.linalg.norm(b, axis=1)
    return np.degrees(np.arccos(cosine.clip(-1, 1)))


def check_tangents(file):
    import bpy

    data = np.load(file)
    mesh = bpy.data.meshes.new("lean")
    mesh.from_pydata(data["vertices"].tolist(), [], data["faces"].tolist())
    mesh.uv_layers.new().data.foreach_set("uv", data["uv"][data["faces"].ravel()].astype(np.float32).ravel())
    mesh.polygons.foreach_set("use_smooth", np.ones(len(data["faces"]), bool))
    mesh.normals_split_custom_set_from_vertices(data["normals"].tolist())
    mesh.calc_tangents()
    tangents, signs = np.empty((len(mesh.loops), 3), np.float32), np.empty(len(mesh.loops), np.float32)
    mesh.loops.foreach_get("tangent", tangents.ravel())
    mesh.loops.foreach_get("bitangent_sign", signs)
    corner = data["faces"].ravel()
    assert {-1.0, 1.0} == set(signs)  # some charts are mirrored
    assert (signs == data["handedness"][corner]).all()
    assert np.quantile(angles(tangents, data["tangents"][corner]), 0.99) < 0.5


def check_cycles(folder):
    """Shows the normals of the material and of the mesh as emitted color, before an orthographic camera at +x."""
    import bpy

    from backend.scene_io.asset_import import import_asset
    from backend.scene_io.image_files import load_pixels

    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    item = import_asset(Path(folder), scene.collection)
    tree = item.data.materials[0].node_tree
    principled = next(node for node in tree.nodes if node.type == "BSDF_PRINCIPLED")
    (link,) = principled.inputs["Normal"].links
    assert link.from_node.type == "NORMAL_MAP"
    (image,) = link.from_node.inputs["Color"].links
    assert image.from_node.image.colorspace_settings.name == "Non-Color"
    output = next(node for node in tree.nodes if node.type == "OUTPUT_MATERIAL")
    scaled, emission = tree.nodes.new("ShaderNodeVectorMath"), tree.nodes.new("ShaderNodeEmission")
    scaled.operation = "MULTIPLY_ADD"
    scaled.inputs[1].default_value = scaled.inputs[2].default_value = (0.5, 0.5, 0.5)
    tree.links.new(scaled.outputs[0], emission.inputs["Color"])
    tree.links.new(emission.outputs[0], output.inputs["Surface"])
    camera = bpy.data.cameras.new("camera")
    camera.type, camera.ortho_scale = "ORTHO", 2.0
    eye = bpy.data.objects.new("camera", camera)
    eye.location, eye.rotation_euler = (5, 0, 0), (np.pi / 2, 0, np.pi / 2)
    scene.collection.objects.link(eye)
    scene.camera, truth = eye, np.load(Path(folder) / "truth.npz")
    scene.render.engine, scene.cycles.device, scene.cycles.samples = "CYCLES", "CPU", 1
    scene.cycles.filter_width, scene.cycles.use_denoising, scene.render.film_transparent = 0.01, False, True
    scene.render.resolution_x = scene.render.resolution_y = SIZE
    settings = scene.render.image_settings
    settings.file_format, settings.color_mode, settings.color_depth = "OPEN_EXR", "RGBA", "32"
    geometry = tree.nodes.new("ShaderNodeNewGeometry")
    found = []
    for normal in (geometry.outputs["Normal"], link.from_node.outputs["Normal"]):
        tree.links.new(normal, scaled.inputs[0])
        with tempfile.TemporaryDirectory() as pictures:
            scene.render.filepath = str(Path(pictures) / "normals.exr")
            bpy.ops.render.render(write_still=True)
            shown = load_pixels(Path(scene.render.filepath))[..., :3]
        found.append(angles(2 * shown[truth["inside"]] - 1, truth["normals"]).mean())
    without, mapped = found
    assert without > 2 and mapped < 0.35 * without, found


if __name__ == "__main__":
    globals()[sys.argv[1]](*sys.argv[2:])
