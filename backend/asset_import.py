"""An asset folder becomes a Blender object, in place, with one Principled material."""
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np


@dataclass(frozen=True)
class Texture:
    """`socket` of the Principled BSDF ('' for one that is only kept at hand) and what the 8-bit file encodes."""
    name: str
    socket: str
    is_colour: bool


TEXTURES = (Texture("albedo", "Base Color", True), Texture("roughness", "Roughness", False),
            Texture("metallic", "Metallic", False), Texture("confidence", "", False))


def import_asset(folder: Path, collection, *, name: str = "", pack: bool = True):
    """Import mesh and material into `collection`; returns the object. OSError where a file is missing or unreadable.

    The mesh keeps the capture's coordinates, is smooth, and has the UV map of the file.
    """
    folder = Path(folder)
    item = _import_mesh(folder / "mesh.obj", collection)
    item.name = item.data.name = name or folder.resolve().name
    item.data.materials.clear()
    item.data.materials.append(build_material(item.name, folder / "textures", pack=pack))
    return item


def build_material(name: str, textures: Path, *, pack: bool = True):
    """Principled BSDF with Base Color, Roughness and Metallic from the asset's textures; confidence unlinked."""
    material = bpy.data.materials.new(name)
    if not material.use_nodes:
        material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    principled = next(node for node in nodes if node.type == "BSDF_PRINCIPLED")
    for row, texture in enumerate(TEXTURES):
        node = nodes.new("ShaderNodeTexImage")
        node.name = node.label = texture.name
        node.location = (-420, 320 - 290 * row)
        node.image = _texture_image(textures, texture, pack)
        if texture.socket:
            links.new(node.outputs["Color"], principled.inputs[texture.socket])
    return material


def load_image(path: Path, *, colour_space: str, pack: bool):
    """An image data-block; packed, or else with a path relative to the saved file where there is one."""
    try:
        image = bpy.data.images.load(str(path), check_existing=False)
    except RuntimeError as error:
        raise OSError(f"Blender cannot read the image {path}") from error
    if not image.size[0]:  # Blender reads the pixels only when asked, and says nothing of a torn file
        bpy.data.images.remove(image)
        raise OSError(f"Blender cannot read the image {path}")
    image.colorspace_settings.name = colour_space
    if pack:
        image.pack()
    elif bpy.data.is_saved:
        image.filepath = bpy.path.relpath(str(path))
    return image


def _texture_image(folder: Path, texture: Texture, pack: bool):
    """The 8-bit file where it exists (what other programs read, and a quarter of the size), else the EXR."""
    path = folder / f"{texture.name}.png"
    space = "sRGB" if texture.is_colour else "Non-Color"
    if not path.is_file():
        path = folder / f"{texture.name}.exr"
        space = "Linear Rec.709" if texture.is_colour else "Non-Color"
    return load_image(path, colour_space=space, pack=pack)


def _import_mesh(path: Path, collection):
    if not path.is_file():
        raise OSError(f"the asset has no {path.name}: {path}")
    objects, materials, images = set(bpy.data.objects), set(bpy.data.materials), set(bpy.data.images)
    try:
        bpy.ops.wm.obj_import(filepath=str(path), forward_axis="Y", up_axis="Z")  # Blender's own axes: as captured
    except RuntimeError as error:
        raise OSError(f"Blender cannot read the mesh {path}: {error}") from error
    imported = [item for item in bpy.data.objects if item not in objects]
    if len(imported) != 1 or not len(imported[0].data.polygons):
        raise OSError(f"{path} holds {len(imported)} objects, or one without faces; one with faces was expected")
    item = imported[0]
    item.data.materials.clear()
    for material in [material for material in bpy.data.materials if material not in materials]:
        bpy.data.materials.remove(material)  # the .mtl's approximation; the real one is built from the textures
    for image in [image for image in bpy.data.images if image not in images]:
        bpy.data.images.remove(image)
    item.data.polygons.foreach_set("use_smooth", np.ones(len(item.data.polygons), bool))
    for other in list(item.users_collection):
        other.objects.unlink(item)
    collection.objects.link(item)
    return item
