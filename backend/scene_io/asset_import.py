"""Imports an asset folder as a Blender object, where the capture saw it, with one Principled material."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import bpy
import numpy as np

from ..plain_files import open_plain
from .color_spaces import DATA, LINEAR, SRGB
from .data_blocks.asset_images import (
    ASSET_KEY,
    CONFIDENCE,
    NORMAL_MAP,
    TEXTURES,
    Texture,
    remove_leftovers,
    shared_image,
)
from .data_blocks.selection import kept_selection

_MOST_BYTES, _PART = 1 << 32, 1 << 24
_BLANKS = bytes(range(33))
"""What Blender passes over at the beginning of a line"""


def import_asset(folder: Path, collection: bpy.types.Collection, *, name: str = "", pack: bool = True) -> bpy.types.Object:
    """Import the mesh and the material of an asset into `collection`, and return the object.

    The mesh keeps the capture's coordinates, the file's smooth normals and its UV map. Its attribute `confidence` (a float
    for each vertex) says where the photos decided the material. `pack`: whether the images are stored in the .blend. Images
    that show the same files already are used again. Where the name is taken, Blender adds a number. The selection stays.
    What is left of deleted objects of this asset is removed. Raises OSError where a file is missing or unreadable; nothing
    is left in the .blend then.
    """
    folder = Path(folder)
    check_asset(folder)
    remove_leftovers(folder)
    with removed_on_error():
        item = _import_mesh(folder / "mesh.obj", collection)
        item.name = item.data.name = name or folder.resolve().name
        material = build_material(item.name, folder / "textures", pack=pack)
        item.data[ASSET_KEY] = material[ASSET_KEY] = os.path.abspath(folder)
        item.data.materials.clear()
        item.data.materials.append(material)
        _add_confidence(item.data, material.node_tree.nodes[CONFIDENCE].image)
    return item


def check_asset(folder: Path) -> None:
    """Raise OSError where `folder` cannot be imported as an asset. The message says what to do."""
    if not folder.is_dir():
        raise OSError(f"there is no folder {folder}. Choose the folder that a reconstruction wrote")
    if not (folder / "mesh.obj").is_file():
        if (folder / "checkpoints").is_dir():
            raise OSError(f"the reconstruction in {folder} has not ended. Resume it first: there is no mesh.obj yet")
        raise OSError(f"{folder} holds no asset: it has no mesh.obj. Choose the folder that a reconstruction wrote")
    for texture in TEXTURES:
        if not any((folder / "textures" / (texture.name + suffix)).is_file() for suffix in (".png", ".exr")):
            raise OSError(
                f"the asset {folder} is incomplete: textures/{texture.name}.png is missing. "
                "Reconstruct again, or put the file back"
            )


@contextmanager
def removed_on_error() -> Iterator[None]:
    """Where an error leaves the `with` block, remove the data-blocks that the block has made.

    These are objects, meshes, materials, images and worlds.
    """
    kinds = (bpy.data.objects, bpy.data.meshes, bpy.data.materials, bpy.data.worlds, bpy.data.images)
    before = [set(kind) for kind in kinds]
    try:
        yield
    except Exception:
        for kind, known in zip(kinds, before, strict=True):
            bpy.data.batch_remove([block for block in kind if block not in known])
        raise


def build_material(name: str, textures: Path, *, pack: bool = True) -> bpy.types.Material:
    """Make a material: a Principled BSDF whose Base Color, Roughness and Metallic come from the folder `textures`.

    If the folder has a normal map, it goes through a Normal Map node. The material also holds an image node with the
    confidence, which is not connected.
    """
    material = bpy.data.materials.new(name)
    if not material.use_nodes:
        material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    principled = next(node for node in nodes if node.type == "BSDF_PRINCIPLED")
    for row, texture in enumerate(TEXTURES):
        node = nodes.new("ShaderNodeTexImage")
        node.name, node.label = texture.name, texture.label
        node.location = (-420, 320 - 290 * row)
        node.image = _texture_image(name, textures, texture, pack)
        if texture.socket:
            links.new(node.outputs["Color"], principled.inputs[texture.socket])
    if any((textures / f"{NORMAL_MAP.name}{suffix}").is_file() for suffix in (".png", ".exr")):
        node = nodes.new("ShaderNodeTexImage")
        node.name, node.label = NORMAL_MAP.name, NORMAL_MAP.label
        node.location = (-420, 320 - 290 * len(TEXTURES))
        node.image = _texture_image(name, textures, NORMAL_MAP, pack)
        tilt = nodes.new("ShaderNodeNormalMap")
        tilt.location = (-120, node.location.y)
        links.new(node.outputs["Color"], tilt.inputs["Color"])
        links.new(tilt.outputs["Normal"], principled.inputs[NORMAL_MAP.socket])
    return material


def _texture_image(owner: str, folder: Path, texture: Texture, pack: bool) -> bpy.types.Image:
    """Load the texture's PNG file where there is one, otherwise its EXR file. Its name is the owner's and the texture's.

    The PNG file has a quarter of the size, and it is the file that other programs read.
    """
    path = folder / f"{texture.name}.png"
    space = SRGB if texture.is_color else DATA
    if not path.is_file():
        path = folder / f"{texture.name}.exr"
        space = LINEAR if texture.is_color else DATA
    return shared_image(path, f"{owner} {texture.name}", color_space=space, pack=pack)


def _shade_smooth(mesh: bpy.types.Mesh) -> None:
    """Make all faces smooth, and keep the normals that the file gives, if it gives any."""
    smooth = np.empty(len(mesh.polygons), bool)
    mesh.polygons.foreach_get("use_smooth", smooth)
    if smooth.all():  # as Blender makes faces of files with normals; to compute the normals would take as long as the import
        return
    normals, custom = _corner_normals(mesh), mesh.has_custom_normals
    mesh.polygons.foreach_set("use_smooth", np.ones(len(mesh.polygons), bool))
    # Blender 4.2 stores the file's normals relative to the mesh's own ones, which the line above has just changed. They are
    # set again only where that changed them, because setting them is slow.
    if custom and not np.allclose(_corner_normals(mesh), normals, atol=1e-3):
        mesh.normals_split_custom_set(normals.tolist())


def _corner_normals(mesh: bpy.types.Mesh) -> np.ndarray:
    """The normals [corners, 3] that the mesh is shaded with."""
    normals = np.empty((len(mesh.loops), 3), np.float32)
    mesh.corner_normals.foreach_get("vector", normals.ravel())
    return normals


def _add_confidence(mesh: bpy.types.Mesh, image: bpy.types.Image) -> None:
    """Add the attribute CONFIDENCE to the mesh.

    Its value at a vertex is the mean, over the vertex's face corners, of the first channel of the nearest texel of `image`.
    """
    width, height = image.size
    pixels = np.empty(width * height * 4, np.float32)
    image.pixels.foreach_get(pixels)  # row 0 is v = 0
    corners = len(mesh.loops)
    uv, vertex = np.empty(2 * corners, np.float32), np.empty(corners, np.int32)
    mesh.attributes[mesh.uv_layers.active.name].data.foreach_get("vector", uv)
    mesh.loops.foreach_get("vertex_index", vertex)
    column, row = np.clip((uv.reshape(-1, 2) * (width, height)).astype(int), 0, (width - 1, height - 1)).T
    value = pixels.reshape(height, width, 4)[row, column, 0]
    count = np.maximum(np.bincount(vertex, minlength=len(mesh.vertices)), 1)
    mean = np.bincount(vertex, value, minlength=len(mesh.vertices)) / count
    attribute = mesh.attributes.new(CONFIDENCE, "FLOAT", "POINT")
    attribute.data.foreach_set("value", mean.astype(np.float32))


def _copy_without_materials(path: Path, target: Path) -> None:
    """Copy an OBJ file without the lines that name its .mtl files. Raises OSError.

    The material is built from the textures anyway, and a .mtl file of a stranger makes Blender open pictures anywhere.
    Blender also takes the .mtl file of the OBJ file's own name, if there is one beside it. The file is copied in large
    parts: line by line, a mesh of 300,000 faces would stall Blender for most of a second.
    """
    begins, leaving_out, rest = (
        True,
        False,
        b"",
    )  # whether a part begins a line, or a line that is left out; what is undecided
    with open_plain(path, _MOST_BYTES) as source, open(target, "wb") as out:
        while read := source.read(_PART):
            part = rest + read
            if leaving_out:
                end = part.find(b"\n") + 1
                if not end:
                    continue
                part, begins = part[end:], True
            kept, leaving_out = _without_naming_lines(part, begins)
            line = kept.rfind(b"\n") + 1
            rest, at_begin = kept[line:].lstrip(_BLANKS), bool(line) or begins
            if at_begin and b"mtllib".startswith(rest):
                out.write(kept[:line])  # blanks at the beginning of a line mean nothing
                begins = True
            else:
                out.write(kept)
                begins, rest = False, b""
        out.write(rest)


def _without_naming_lines(part: bytes, begins: bool) -> tuple[bytes, bool]:
    """(the part of an OBJ file without the lines that begin with mtllib, whether it ends inside such a line).

    `begins`: whether the part begins with the beginning of a line.
    """
    kept, start, search = [], 0, 0
    while (found := part.find(b"mtllib", search)) >= 0:
        line = part.rfind(b"\n", 0, found) + 1
        search = found + 1
        if part[line:found].strip(_BLANKS) or not (line or begins):
            continue
        kept.append(part[start:line])
        end = part.find(b"\n", found) + 1
        if not end:
            return b"".join(kept), True
        start = search = end
    return b"".join([*kept, part[start:]]), False


def _import_mesh(path: Path, collection: bpy.types.Collection) -> bpy.types.Object:
    objects, materials, images = set(bpy.data.objects), set(bpy.data.materials), set(bpy.data.images)
    with tempfile.TemporaryDirectory() as folder:
        alone = Path(folder) / path.name
        _copy_without_materials(path, alone)
        try:
            # With these axes Blender does not turn the mesh: it keeps the capture's coordinates.
            with kept_selection():
                bpy.ops.wm.obj_import(filepath=str(alone), forward_axis="Y", up_axis="Z", validate_meshes=True)
        except RuntimeError as error:
            raise OSError(f"Blender cannot read the mesh {path}: {error}") from error
    imported = [item for item in bpy.data.objects if item not in objects]
    if len(imported) != 1 or not len(imported[0].data.polygons):
        raise OSError(f"{path} holds {len(imported)} objects, or one without faces; one with faces was expected")
    item = imported[0]
    if not item.data.uv_layers:
        raise OSError(f"{path} has no UV map: its textures cannot be placed")
    item.data.materials.clear()
    for material in [material for material in bpy.data.materials if material not in materials]:
        # The .mtl file's material is only an approximation. The full material is built from the textures.
        bpy.data.materials.remove(material)
    for image in [image for image in bpy.data.images if image not in images]:
        bpy.data.images.remove(image)
    _shade_smooth(item.data)
    for other in list(item.users_collection):
        other.objects.unlink(item)
    collection.objects.link(item)
    return item
