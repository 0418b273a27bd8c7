"""The import of an asset folder as a Blender object: geometry, material, images, and what is refused."""

import shutil
import sys
from pathlib import Path

import numpy as np
from PIL import Image

from support.blender_checks import told_in
from support.own_process import in_blender


def test_assets_are_imported_as_their_files_say_or_refused(asset):
    in_blender(check_assets, asset)


def check_assets(asset):
    """Each check is on a copy of the asset, which it may change, and begins with a new file."""
    checks = (check_import, check_confidence, check_exr_texture, check_without_mesh, check_damaged_texture)
    for check in (*checks, check_parts, check_foreign_materials):
        with told_in(check.__name__):
            check(Path(shutil.copytree(asset, Path(asset).with_name(check.__name__))))


def check_import(asset):
    """The object has the mesh and the textures of the asset's files."""
    import bpy

    from backend.scene_io.asset_import import import_asset

    bpy.ops.wm.read_factory_settings(use_empty=True)
    item = import_asset(asset, bpy.context.scene.collection, name="thing")
    world = np.array([item.matrix_world @ vertex.co for vertex in item.data.vertices])
    corners = [line.split()[1:] for line in (asset / "mesh.obj").read_text().splitlines() if line.startswith("v ")]
    np.testing.assert_allclose(world, np.array(corners, float), atol=1e-6)
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


def check_parts(asset):
    """A large file is copied in parts. Wherever these end, the lines are left out that a rule for whole lines leaves out."""
    from backend.scene_io import asset_import

    blanks = " \t\r\x01"
    content = "".join(
        [
            "mtllib a\nv 1 2 3\n mtllib b\n# mtllib c\nmtllibd\nmtl\nmtlli",
            f"\n{blanks * 9}mtllib e mtllib f\n{blanks}\n\nvn 0 0 1 mtllib\nmtllib g",
        ]
    ).encode()
    lines = content.split(b"\n")
    expected = [line.lstrip(bytes(range(33))) for line in lines if not line.lstrip(bytes(range(33))).startswith(b"mtllib")]
    for end in (b"", b"\n", b" mtl"):
        (asset / "mesh.obj").write_bytes(content + end)
        for asset_import._PART in (1, 2, 5, 6, 7, 50, 1 << 24):
            asset_import._copy_without_materials(asset / "mesh.obj", asset / "copy.obj")
            copied = [line.lstrip(bytes(range(33))) for line in (asset / "copy.obj").read_bytes().split(b"\n")]
            assert [line for line in copied if line] == [line for line in expected if line], (end, asset_import._PART)


def check_foreign_materials(asset):
    """A .mtl file of a stranger names a picture elsewhere. Blender itself opens it, however the OBJ file names the .mtl."""
    import bpy

    from backend.scene_io import asset_import

    Image.new("RGB", (4, 4)).save(asset / "private.png")
    (asset / "mesh.mtl").write_text(f"newmtl thing\nmap_Kd {asset / 'private.png'}\n")
    lines = [line for line in (asset / "mesh.obj").read_text().splitlines() if not line.startswith(("mtllib", "usemtl"))]
    first = next(number for number, line in enumerate(lines) if line.startswith("f "))
    for naming in (
        "mtllib mesh.mtl",
        " \t mtllib mesh.mtl",
        "o mtllib\n\r mtllib mesh.mtl",
        "# no mtllib: that of its own name",
    ):
        bpy.ops.wm.read_factory_settings(use_empty=True)
        (asset / "mesh.obj").write_text(
            "\n".join([naming, *lines[:first], "usemtl thing", *lines[first:], ""]), newline="\n"
        )
        bpy.ops.wm.obj_import(filepath=str(asset / "mesh.obj"))
        assert [image.name for image in bpy.data.images] == ["private.png"], naming
        bpy.ops.wm.read_factory_settings(use_empty=True)
        (asset / "alone").mkdir(exist_ok=True)
        asset_import._copy_without_materials(asset / "mesh.obj", asset / "alone" / "mesh.obj")
        bpy.ops.wm.obj_import(filepath=str(asset / "alone" / "mesh.obj"))
        assert not bpy.data.images and len(bpy.data.objects) == 1, naming
        bpy.ops.wm.read_factory_settings(use_empty=True)
        asset_import.import_asset(asset, bpy.context.scene.collection)
        assert len(bpy.data.images) == 4 and len(bpy.data.materials) == 1


def check_confidence(asset):
    """Each vertex has that of its texel. The asset's four vertices have the four corners of the texture as their UVs."""
    import bpy

    from backend.scene_io.asset_import import import_asset

    pixels = np.full((8, 8), 255, np.uint8)
    pixels[7, 0], pixels[7, 7], pixels[0, 0], pixels[0, 7] = 51, 102, 153, 204  # (u, v) = 0 0, 1 0, 0 1, 1 1
    Image.fromarray(pixels).save(asset / "textures" / "confidence.png")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    item = import_asset(asset, bpy.context.scene.collection)
    values = [point.value for point in item.data.attributes["confidence"].data]
    np.testing.assert_allclose(values, [0.2, 0.4, 0.6, 0.8], atol=1e-6)


def check_exr_texture(asset):
    """It stands in for a missing PNG."""
    import bpy

    from backend.scene_io.asset_import import import_asset

    (asset / "textures" / "albedo.png").unlink()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    item = import_asset(asset, bpy.context.scene.collection)
    image = item.data.materials[0].node_tree.nodes["albedo"].image
    assert image.filepath.endswith(".exr") and image.colorspace_settings.name == "Linear Rec.709"


def check_without_mesh(asset):
    (asset / "mesh.obj").unlink()
    check_refused(asset, "it has no mesh.obj")


def check_damaged_texture(asset):
    (asset / "textures" / "metallic.png").write_bytes(b"torn")
    check_refused(asset, "metallic.png")


def check_refused(asset, message):
    """The import fails, and leaves nothing in the file."""
    import bpy

    from backend.scene_io.asset_import import import_asset

    bpy.ops.wm.read_factory_settings(use_empty=True)
    try:
        import_asset(asset, bpy.context.scene.collection)
    except OSError as error:
        assert message in str(error), error
    else:
        raise AssertionError("the asset was imported")
    assert not [*bpy.data.objects, *bpy.data.meshes, *bpy.data.materials, *bpy.data.images]


if __name__ == "__main__":
    globals()[sys.argv[1]](*sys.argv[2:])
