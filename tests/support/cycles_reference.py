"""Renders the reference of test_cycles.py; runs in a process of its own, because it needs bpy.

    python cycles_reference.py MESH.npz LIGHT.exr OUT.npz MATERIALS.json

The mesh (vertices, faces, corner normals by smooth shading) stands in the light of an equirectangular image, before an
orthographic camera at +x. OUT holds the linear images [materials, size, size, 4].
"""

import json
import sys
import tempfile
from pathlib import Path

import bpy
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from backend.scene_io.image_files import load_pixels
from backend.scene_io.world import build_world
from support.blender_checks import with_small_light_map

SIZE, SAMPLES, WIDTH = 64, 256, 2.0

mesh_file, light, out, materials = sys.argv[1:]
bpy.ops.wm.read_factory_settings(use_empty=True)
scene = bpy.context.scene
data = np.load(mesh_file)
mesh = bpy.data.meshes.new("object")
mesh.from_pydata(data["vertices"].tolist(), [], data["faces"].tolist())
mesh.polygons.foreach_set("use_smooth", np.ones(len(data["faces"]), bool))
item = bpy.data.objects.new("object", mesh)
scene.collection.objects.link(item)
material = bpy.data.materials.new("material")
material.use_nodes = True
principled = next(n for n in material.node_tree.nodes if n.type == "BSDF_PRINCIPLED")
mesh.materials.append(material)
camera = bpy.data.cameras.new("camera")
camera.type, camera.ortho_scale = "ORTHO", WIDTH
eye = bpy.data.objects.new("camera", camera)
eye.location, eye.rotation_euler = (5, 0, 0), (np.pi / 2, 0, np.pi / 2)
scene.collection.objects.link(eye)
scene.camera, scene.world = eye, with_small_light_map(build_world(Path(light), name="light"))
scene.render.engine, scene.cycles.device = "CYCLES", "CPU"
scene.cycles.samples, scene.cycles.use_adaptive_sampling, scene.cycles.use_denoising = SAMPLES, False, False
scene.cycles.filter_width = 0.01  # a pixel is what its own center sees, as far as Cycles allows
scene.cycles.sample_clamp_indirect = scene.cycles.sample_clamp_direct = 0
scene.cycles.max_bounces = scene.cycles.diffuse_bounces = scene.cycles.glossy_bounces = int(data["bounces"])
scene.render.film_transparent = True
scene.render.resolution_x = scene.render.resolution_y = SIZE
settings = scene.render.image_settings
settings.file_format, settings.color_mode, settings.color_depth = "OPEN_EXR", "RGBA", "32"
images = []
for values in json.loads(materials):
    principled.inputs["Base Color"].default_value = (*values["albedo"], 1)
    principled.inputs["Roughness"].default_value = values["roughness"]
    principled.inputs["Metallic"].default_value = values["metallic"]
    with tempfile.TemporaryDirectory() as folder:
        scene.render.filepath = str(Path(folder) / "image.exr")
        bpy.ops.render.render(write_still=True)
        images.append(load_pixels(Path(scene.render.filepath)))
np.savez(out, images=np.array(images))
