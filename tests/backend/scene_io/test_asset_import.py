"""The import of an asset folder as a Blender object: geometry, material, images, and what is refused."""

import json
import sys
from pathlib import Path

import numpy as np
from PIL import Image

from support.own_process import in_blender


def test_an_imported_asset_has_the_mesh_and_the_textures_of_its_files(asset):
    corners = [line.split()[1:] for line in (asset / "mesh.obj").read_text().splitlines() if line.startswith("v ")]
    in_blender(check_import, asset, json.dumps([[float(x) for x in corner] for corner in corners]))


def check_import(asset, corners):
    import bpy

    from backend.scene_io.asset_import import import_asset

    bpy.ops.wm.read_factory_settings(use_empty=True)
    item = import_asset(Path(asset), bpy.context.scene.collection, name="thing")
    world = np.array([item.matrix_world @ vertex.co for vertex in item.data.vertices])
    np.testing.assert_allclose(world, json.loads(corners), atol=1e-6)
    assert all(polygon.use_smooth for polygon in item.data.polygons) and len(item.data.uv_layers) == 1
    assert len(bpy.data.materials) == 1 and len(item.data.materials) == 1 and item.name == "thing"
    nodes = item.data.materials[0].node_tree.nodes
    principled = next(node for node in nodes if node.type == "BSDF_PRINCIPLED")
    for socket, name, space in (
        ("Base Color", "albedo", "sRGB"),
        ("Roughness", "roughness", "Non-Color"),
        ("Metallic", "metallic", "Non-Color"),
    ):
        (link,) = principled.inputs[socket].links
        assert link.from_node.name == name and link.from_node.image.colorspace_settings.name == space
    assert nodes["confidence"].image.colorspace_settings.name == "Non-Color"
    assert len(bpy.data.images) == 4 and all(image.packed_file for image in bpy.data.images)


def test_each_vertex_has_the_confidence_of_its_texel(asset):
    """The asset's four vertices have the four corners of the texture as their UVs."""
    pixels = np.full((8, 8), 255, np.uint8)
    pixels[7, 0], pixels[7, 7], pixels[0, 0], pixels[0, 7] = 51, 102, 153, 204  # (u, v) = 0 0, 1 0, 0 1, 1 1
    Image.fromarray(pixels).save(asset / "textures" / "confidence.png")
    in_blender(check_confidence, asset)


def check_confidence(asset):
    import bpy

    from backend.scene_io.asset_import import import_asset

    bpy.ops.wm.read_factory_settings(use_empty=True)
    item = import_asset(Path(asset), bpy.context.scene.collection)
    values = [point.value for point in item.data.attributes["confidence"].data]
    np.testing.assert_allclose(values, [0.2, 0.4, 0.6, 0.8], atol=1e-6)


def test_the_exr_texture_stands_in_for_a_missing_png(asset):
    (asset / "textures" / "albedo.png").unlink()
    in_blender(check_exr_texture, asset)


def check_exr_texture(asset):
    import bpy

    from backend.scene_io.asset_import import import_asset

    bpy.ops.wm.read_factory_settings(use_empty=True)
    item = import_asset(Path(asset), bpy.context.scene.collection)
    image = item.data.materials[0].node_tree.nodes["albedo"].image
    assert image.filepath.endswith(".exr") and image.colorspace_settings.name == "Linear Rec.709"


def test_an_asset_without_a_mesh_is_refused(asset):
    (asset / "mesh.obj").unlink()
    in_blender(check_refused, asset, "it has no mesh.obj")


def test_a_damaged_texture_leaves_nothing_in_the_file(asset):
    (asset / "textures" / "metallic.png").write_bytes(b"torn")
    in_blender(check_refused, asset, "metallic.png")


def check_refused(asset, message):
    import bpy

    from backend.scene_io.asset_import import import_asset

    bpy.ops.wm.read_factory_settings(use_empty=True)
    try:
        import_asset(Path(asset), bpy.context.scene.collection)
    except OSError as error:
        assert message in str(error), error
    else:
        raise AssertionError("the asset was imported")
    assert not [*bpy.data.objects, *bpy.data.meshes, *bpy.data.materials, *bpy.data.images]


if __name__ == "__main__":
    globals()[sys.argv[1]](*sys.argv[2:])
