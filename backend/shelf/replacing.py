"""Gives objects of a scene the mesh and the material of an object that was imported in their place."""

from collections.abc import Sequence

import bpy


def take_over(old: Sequence[bpy.types.Object], new: bpy.types.Object) -> None:
    """Give the objects `old` the mesh and the material of `new`, and remove `new`.

    The objects keep their place, their name and their collections. Copies that share a mesh with them get the new one, too.
    The old meshes, materials and images are removed, but for those that something else uses.
    """
    mesh, meshes = new.data, {item.data for item in old}
    name = next(iter(meshes)).name
    materials = {material for before in meshes for material in before.materials if material is not None}
    images = {image for material in materials for image in _images(material)}
    for before in meshes:
        before.user_remap(mesh)
    bpy.data.objects.remove(new)
    for blocks in (meshes, materials, images):
        bpy.data.batch_remove([block for block in blocks if block.users == 0])
    mesh.name = mesh.materials[0].name = name
    for node in mesh.materials[0].node_tree.nodes:
        if node.type == "TEX_IMAGE" and node.image is not None and node.image.users == 1:
            node.image.name = f"{name} {node.name}"


def _images(material: bpy.types.Material) -> list[bpy.types.Image]:
    nodes = material.node_tree.nodes if material.node_tree else ()
    return [node.image for node in nodes if node.type == "TEX_IMAGE" and node.image is not None]
