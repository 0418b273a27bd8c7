"""Builds scenes for synthetic captures: a glossy object that floats in a room among solid things, lamps and a window.

The scenes follow NeP's synthetic set (Wang et al., CVPR 2024). The surroundings are near. Therefore an environment map at
infinity cannot explain their parallax and their reflections in the object. All light comes from inside the room. The object
is scaled to fit into the sphere of radius 1 at the origin, which is the border between object and environment.
"""

import math
from collections.abc import Sequence
from pathlib import Path

import bmesh
import bpy
import numpy as np
from mathutils import Matrix, Vector

from .substances import Substance

FLOOR, CEILING, HALF_WIDTH = -1.45, 4.2, 5.2
OBJECT_RADIUS = 1.0
FILL = 0.97  # the object's radius as a part of OBJECT_RADIUS; below 1, so that no vertex touches the border


# Name -> (pattern, substances). The patterns are 'uniform', 'patches' (random cells) and 'stripes' (bands along z).
MATERIALS = {
    "gold": ("uniform", (Substance((0.9, 0.62, 0.3), 0.2, 1.0),)),
    "steel": ("stripes", (Substance((0.62, 0.6, 0.58), 0.12, 1.0), Substance((0.62, 0.6, 0.58), 0.3, 1.0))),
    "patches": ("patches", (Substance((0.6, 0.05, 0.04), 0.15, 0.0), Substance((0.9, 0.85, 0.75), 0.25, 1.0))),
    "stripes": ("stripes", (Substance((0.04, 0.14, 0.5), 0.15, 0.0), Substance((0.93, 0.55, 0.4), 0.22, 1.0))),
    "chalk": ("uniform", (Substance((0.55, 0.5, 0.4), 0.8, 0.0),)),
    "glaze": ("patches", (Substance((0.7, 0.6, 0.4), 0.12, 0.0), Substance((0.05, 0.25, 0.2), 0.12, 0.0))),
}
DEFAULT_MATERIAL = {"suzanne": "gold", "box": "patches"}
GROUND_TRUTH_COLOR = "albedo"
GROUND_TRUTH_VALUES = ("roughness", "metallic", "mask")


def build_scene(
    source: str, material: str, rng: np.random.Generator, patterned: bool = False, alone: bool = False
) -> tuple[bpy.types.Object, list[bpy.types.Object]]:
    """Build a scene in the current file, which must be empty. Returns (object, obstacles).

    An obstacle is every mesh that is not the object. `source` is 'suzanne', 'box' or the path of an obj, ply, stl, glb or
    gltf file. `patterned`: the floor, the pictures and the things have prints, so that structure from motion finds features.
    `alone`: only the object is built. Raises ValueError for other sources, and for a mesh file that cannot be used (see
    `mesh_file`).
    """
    target = _object(source)
    normalize(target)
    target.data.materials.clear()
    target.data.materials.append(object_material(*MATERIALS[material], rng))
    if alone:
        return target, []
    room, lights, things = _room(rng), _lights(rng), _things(rng)
    prints = [item for item in room if item.name.startswith(("floor", "picture"))] + things
    for item in prints if patterned else ():
        item.data.materials[0] = printed(f"print on {item.name}", rng)
    return target, room + lights + things


def triangles(item: bpy.types.Object) -> tuple[np.ndarray, np.ndarray]:
    """(vertices [V,3] float32 in world space, triangles [F,3] int32) of a mesh object, with its modifiers applied."""
    evaluated = item.evaluated_get(bpy.context.evaluated_depsgraph_get())
    mesh = evaluated.to_mesh()
    mesh.calc_loop_triangles()
    vertices = np.empty(len(mesh.vertices) * 3, np.float32)
    faces = np.empty(len(mesh.loop_triangles) * 3, np.int32)
    mesh.vertices.foreach_get("co", vertices)
    mesh.loop_triangles.foreach_get("vertices", faces)
    evaluated.to_mesh_clear()
    matrix = np.array(item.matrix_world, np.float32)
    return vertices.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3], faces.reshape(-1, 3)


def _object(source: str) -> bpy.types.Object:
    if source == "suzanne":
        bpy.ops.mesh.primitive_monkey_add()
        target = bpy.context.object
        target.modifiers.new("subdivision", "SUBSURF").render_levels = 2
        target.modifiers[0].levels = 2
        apply_modifiers(target)
        target.data.shade_smooth()
    elif source == "box":
        bpy.ops.mesh.primitive_cube_add()
        target = bpy.context.object
        target.scale = (1.0, 0.8, 0.7)
        target.rotation_euler = (0.3, 0.2, 0.5)
        bpy.ops.object.transform_apply(location=False)
        bevel = target.modifiers.new("bevel", "BEVEL")
        bevel.width, bevel.segments, bevel.harden_normals = 0.12, 4, True
        target.data.shade_smooth()
        apply_modifiers(target)
    else:
        target = mesh_file(Path(source))
        target.data.shade_smooth()
        target.data.set_sharp_from_angle(angle=math.radians(40))
    target.name = target.data.name = "object"
    return target


def mesh_file(path: Path) -> bpy.types.Object:
    """Add the meshes of a file to the scene, as one object.

    Raises ValueError, with the path, where the file is missing, is no mesh file, cannot be read, or holds no mesh with faces
    and an extent.
    """
    operators = {
        ".obj": bpy.ops.wm.obj_import,
        ".ply": bpy.ops.wm.ply_import,
        ".stl": bpy.ops.wm.stl_import,
        ".glb": bpy.ops.import_scene.gltf,
        ".gltf": bpy.ops.import_scene.gltf,
    }
    if path.suffix.lower() not in operators:
        raise ValueError(f"{path}: neither 'suzanne' nor 'box' nor a mesh file ({', '.join(operators)})")
    if not path.is_file():
        raise ValueError(f"{path}: there is no such file")
    before = set(bpy.data.objects)
    try:
        operators[path.suffix.lower()](filepath=str(path))
    except RuntimeError as error:  # its last line is the reason; an importer in Python gives a whole traceback
        raise ValueError(f"{path}: this mesh cannot be read ({str(error).strip().splitlines()[-1]})") from error
    meshes = [item for item in bpy.data.objects if item not in before and item.type == "MESH"]
    if not meshes:
        raise ValueError(f"{path}: no mesh in it")
    bpy.ops.object.select_all(action="DESELECT")
    for item in meshes:
        item.select_set(True)
    bpy.context.view_layer.objects.active = meshes[0]
    if len(meshes) > 1:
        bpy.ops.object.join()
    target = bpy.context.view_layer.objects.active
    matrix = target.matrix_world.copy()
    target.parent = None
    target.matrix_world = matrix
    for item in [item for item in bpy.data.objects if item not in before and item != target]:
        bpy.data.objects.remove(item)  # removes the lights, cameras and empties that the file holds
    target.data.polygons.foreach_set("material_index", np.zeros(len(target.data.polygons), np.int32))
    bpy.context.view_layer.update()
    vertices, faces = triangles(target)
    if not len(faces):
        raise ValueError(f"{path}: the mesh has no faces")
    if not np.ptp(vertices, axis=0).max() > 0 or not np.isfinite(vertices).all():
        raise ValueError(f"{path}: all points of the mesh coincide, or one is not a number")
    return target


def apply_modifiers(item: bpy.types.Object) -> None:
    bpy.context.view_layer.objects.active = item
    for modifier in list(item.modifiers):
        bpy.ops.object.modifier_apply(modifier=modifier.name)


def normalize(item: bpy.types.Object) -> None:
    bpy.context.view_layer.update()
    vertices, _ = triangles(item)
    center = (vertices.min(0) + vertices.max(0)) / 2
    radius = float(np.linalg.norm(vertices - center, axis=1).max())
    scale = FILL * OBJECT_RADIUS / radius
    matrix = item.matrix_world.copy()
    item.matrix_world.identity()
    item.data.transform(matrix)
    item.data.transform(Matrix.Scale(scale, 4) @ Matrix.Translation(Vector((-center).tolist())))
    bpy.context.view_layer.update()


def object_material(pattern: str, substances: tuple[Substance, ...], rng: np.random.Generator) -> bpy.types.Material:
    """The object's Principled material. The values of its inputs also go to the AOVs, which become the ground truth."""
    material, nodes, links = new_material("object")
    factor = None if pattern == "uniform" else _pattern(nodes, links, pattern, rng)
    first, second = substances[0], substances[-1]
    sockets = {
        "albedo": blend(nodes, links, factor, first.color, second.color),
        "roughness": blend(nodes, links, factor, (first.roughness,) * 3, (second.roughness,) * 3),
        "metallic": blend(nodes, links, factor, (first.metallic,) * 3, (second.metallic,) * 3),
    }
    link_with_truth(nodes, links, sockets)
    return material


def new_material(name: str) -> tuple[bpy.types.Material, bpy.types.Nodes, bpy.types.NodeLinks]:
    """A new material with a Principled BSDF, its nodes, and its links."""
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    return material, material.node_tree.nodes, material.node_tree.links


def link_with_truth(nodes: bpy.types.Nodes, links: bpy.types.NodeLinks, sockets: dict[str, bpy.types.NodeSocket]) -> None:
    """Link the sockets 'albedo', 'roughness' and 'metallic' to the Principled BSDF and to the AOVs of the ground truth."""
    principled = next(node for node in nodes if node.type == "BSDF_PRINCIPLED")
    for name, socket in (("albedo", "Base Color"), ("roughness", "Roughness"), ("metallic", "Metallic")):
        links.new(sockets[name], principled.inputs[socket])
    for name, output in (sockets | {"mask": blend(nodes, links, None, (1, 1, 1), (1, 1, 1))}).items():
        aov = nodes.new("ShaderNodeOutputAOV")
        aov.aov_name = name
        links.new(output, aov.inputs["Color" if name == GROUND_TRUTH_COLOR else "Value"])


def _pattern(
    nodes: bpy.types.Nodes, links: bpy.types.NodeLinks, pattern: str, rng: np.random.Generator
) -> bpy.types.NodeSocket:
    """A socket that is 0 on the first substance and 1 on the second."""
    coordinates = nodes.new("ShaderNodeTexCoord").outputs["Object"]
    threshold = nodes.new("ShaderNodeMath")
    threshold.operation = "GREATER_THAN"
    separate = nodes.new("ShaderNodeSeparateXYZ")
    if pattern == "patches":
        shift = nodes.new("ShaderNodeVectorMath")
        shift.inputs[1].default_value = rng.uniform(-10, 10, 3)
        cells = nodes.new("ShaderNodeTexVoronoi")
        cells.inputs["Scale"].default_value = 2.2
        links.new(coordinates, shift.inputs[0])
        links.new(shift.outputs[0], cells.inputs["Vector"])
        links.new(cells.outputs["Color"], separate.inputs[0])
        links.new(separate.outputs[0], threshold.inputs[0])
        threshold.inputs[1].default_value = 0.5
    else:
        wave = nodes.new("ShaderNodeMath")
        wave.operation = "PINGPONG"
        wave.inputs[1].default_value = 0.25
        links.new(coordinates, separate.inputs[0])
        links.new(separate.outputs[2], wave.inputs[0])
        links.new(wave.outputs[0], threshold.inputs[0])
        threshold.inputs[1].default_value = 0.125
    return threshold.outputs[0]


def blend(
    nodes: bpy.types.Nodes,
    links: bpy.types.NodeLinks,
    factor: bpy.types.NodeSocket | None,
    first: Sequence[float] | bpy.types.NodeSocket,
    second: Sequence[float] | bpy.types.NodeSocket,
) -> bpy.types.NodeSocket:
    """A socket with the color `first` where `factor` is 0, and `second` where `factor` is 1.

    Where `factor` is None, the color is `first` everywhere. Both colors may be sockets.
    """
    mix = nodes.new("ShaderNodeMix")
    mix.data_type = "RGBA"
    for socket, color in zip((socket for socket in mix.inputs if socket.type == "RGBA"), (first, second), strict=True):
        if isinstance(color, bpy.types.NodeSocket):
            links.new(color, socket)
        else:
            socket.default_value = (*color, 1)
    mix.inputs[0].default_value = 0
    if factor is not None:
        links.new(factor, mix.inputs[0])
    return next(socket for socket in mix.outputs if socket.type == "RGBA")


def _room(rng: np.random.Generator) -> list[bpy.types.Object]:
    middle, height, width = (FLOOR + CEILING) / 2, CEILING - FLOOR, 2 * HALF_WIDTH
    boxes = [
        ("floor", (0, 0, FLOOR - 0.05), (width, width, 0.1), 1.1),
        ("ceiling", (0, 0, CEILING + 0.05), (width, width, 0.1), 0),
    ]
    for number, (x, y) in enumerate(((1, 0), (-1, 0), (0, 1), (0, -1))):
        size = (0.1, width, height) if x else (width, 0.1, height)
        reach = HALF_WIDTH + 0.05
        boxes.append((f"wall{number}", (x * reach, y * reach, middle), size, (0, 0.7)[number % 2]))
    room = []
    for name, location, size, checker in boxes:
        item = box(name, location, size)
        item.data.materials.append(surface(name, rng, 0.7, checker, pale=name == "ceiling"))
        room.append(item)
    for number, side in enumerate((-1, 1)):  # two pictures on a wall give detail that reflections can show
        item = box(f"picture{number}", (side * 2.0, HALF_WIDTH - 0.04, 0.9), (1.4, 0.05, 1.0))
        item.data.materials.append(surface(item.name, rng, 0.5, 6.0))
        room.append(item)
    return room


def _lights(rng: np.random.Generator) -> list[bpy.types.Object]:
    bar = surface("window bars", rng, 0.6)
    lights = []
    for name, location, size, color, strength in (
        ("window", (-HALF_WIDTH + 0.02, 0.8, 1.5), (0.04, 3.0, 2.0), (0.9, 0.95, 1.0), 8.0),
        ("ceiling lamp", (1.5, 1.0, CEILING - 0.03), (1.8, 1.2, 0.04), (1.0, 0.95, 0.85), 22.0),
        ("lantern", (-3.0, -3.0, 2.6), (0.8, 0.8, 0.8), (0.6, 0.8, 1.0), 10.0),
    ):
        item = box(name, location, size)
        item.data.materials.append(emission(name, color, strength))
        lights.append(item)
    for name, location, size in (
        ("bar0", (-HALF_WIDTH + 0.07, 0.8, 1.5), (0.06, 0.1, 2.1)),
        ("bar1", (-HALF_WIDTH + 0.07, 0.8, 1.5), (0.06, 3.1, 0.1)),
    ):
        item = box(name, location, size)
        item.data.materials.append(bar)
        lights.append(item)
    return lights


def _things(rng: np.random.Generator, count: int = 16) -> list[bpy.types.Object]:
    """Boxes, spheres and columns that stand on the floor around the object.

    None of them reaches into the object's sphere or into another one.
    """
    things, taken = [], []
    while len(things) < count:
        angle = len(things) * 2.399963 + rng.uniform(-0.3, 0.3)  # steps of the golden angle spread them all around
        column = len(things) % 5 == 2
        distance = rng.uniform(4.2, 4.7) if column else rng.uniform(1.9, 4.2)
        size = rng.uniform(0.25, 0.35) if column else rng.uniform(0.22, 0.5)
        x, y = distance * math.cos(angle), distance * math.sin(angle)
        if any(math.hypot(x - a, y - b) < 1.5 * (size + other) for a, b, other in taken):
            size *= 0.6
            if any(math.hypot(x - a, y - b) < 1.5 * (size + other) for a, b, other in taken):
                continue
        taken.append((x, y, size))
        things.append(_thing(len(things), column, (x, y), size, angle, rng))
    return things


def _thing(
    number: int, column: bool, place: tuple[float, float], size: float, angle: float, rng: np.random.Generator
) -> bpy.types.Object:
    """Add a box, a sphere or a column on the floor at `place` (x, y), and return it."""
    x, y = place
    name = f"thing{number}"
    if column:
        height = rng.uniform(1.6, 3.2)
        bpy.ops.mesh.primitive_cylinder_add(vertices=64, radius=size, depth=height, location=(x, y, FLOOR + height / 2))
        bpy.context.object.data.shade_smooth()
        bpy.context.object.data.set_sharp_from_angle(angle=math.radians(40))
    elif number % 2:
        bpy.ops.mesh.primitive_uv_sphere_add(segments=48, ring_count=24, radius=size, location=(x, y, FLOOR + size))
        bpy.context.object.data.shade_smooth()
    else:
        box(name, (x, y, FLOOR + size), (2 * size, 1.6 * size, 2 * size)).rotation_euler.z = angle
    item = bpy.data.objects[name] if name in bpy.data.objects else bpy.context.object
    item.name = name
    item.data.materials.append(surface(name, rng, rng.uniform(0.3, 0.8), (0, 7.0, 0, 12.0)[number % 4]))
    return item


def box(name: str, location: Sequence[float], size: Sequence[float]) -> bpy.types.Object:
    mesh = bpy.data.meshes.new(name)
    work = bmesh.new()
    bmesh.ops.create_cube(work, size=1.0)
    work.to_mesh(mesh)
    work.free()
    item = bpy.data.objects.new(name, mesh)
    item.location, item.scale = location, size
    bpy.context.scene.collection.objects.link(item)
    return item


def surface(
    name: str, rng: np.random.Generator, roughness: float, checker: float = 0, pale: bool = False
) -> bpy.types.Material:
    """A dielectric material of a random color, or near white with `pale`.

    Where `checker` is not 0, the material is a checker of two colors with `checker` cells per unit of world length.
    """
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    principled = next(node for node in nodes if node.type == "BSDF_PRINCIPLED")
    principled.inputs["Roughness"].default_value = roughness
    colors = [(0.8, 0.8, 0.78, 1)] if pale else [(*rng.uniform(0.05, 0.8, 3), 1) for _ in range(2)]
    principled.inputs["Base Color"].default_value = colors[0]
    if checker:
        texture = nodes.new("ShaderNodeTexChecker")
        texture.inputs["Scale"].default_value = checker
        texture.inputs["Color1"].default_value, texture.inputs["Color2"].default_value = colors
        position = nodes.new("ShaderNodeNewGeometry").outputs["Position"]
        shift = nodes.new("ShaderNodeVectorMath")  # moves cell borders away from flat faces, where they would flicker
        shift.inputs[1].default_value = (0.0171, 0.0171, 0.0171)
        links.new(position, shift.inputs[0])
        links.new(shift.outputs[0], texture.inputs["Vector"])
        links.new(texture.outputs["Color"], principled.inputs["Base Color"])
    return material


def plain(name: str, color: Sequence[float], roughness: float) -> bpy.types.Material:
    """A dielectric material of one color."""
    material, nodes, _ = new_material(name)
    principled = next(node for node in nodes if node.type == "BSDF_PRINCIPLED")
    principled.inputs["Base Color"].default_value = (*color, 1)
    principled.inputs["Roughness"].default_value = roughness
    return material


def printed(name: str, rng: np.random.Generator, scale: float = 1.0, moves: bool = False) -> bpy.types.Material:
    """A dielectric material with a print of colored cells of several sizes, which repeats nowhere.

    `moves`: the print moves with the thing that has it. The largest cells have a width of about 0.4 / `scale`.
    """
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    nodes, links = material.node_tree.nodes, material.node_tree.links
    principled = next(node for node in nodes if node.type == "BSDF_PRINCIPLED")
    principled.inputs["Roughness"].default_value = 0.7
    shift = nodes.new("ShaderNodeVectorMath")
    shift.inputs[1].default_value = rng.uniform(-50, 50, 3)
    place = ("ShaderNodeTexCoord", "Object") if moves else ("ShaderNodeNewGeometry", "Position")
    links.new(nodes.new(place[0]).outputs[place[1]], shift.inputs[0])
    color = None
    for cells_of_unit in (2.5, 9.0, 30.0):
        cells = nodes.new("ShaderNodeTexVoronoi")
        cells.inputs["Scale"].default_value = cells_of_unit * scale
        links.new(shift.outputs[0], cells.inputs["Vector"])
        if color is None:
            color = cells.outputs["Color"]
            continue
        mix = nodes.new("ShaderNodeMix")
        mix.data_type, mix.inputs[0].default_value = "RGBA", 0.3
        first, second = (socket for socket in mix.inputs if socket.type == "RGBA")
        links.new(color, first)
        links.new(cells.outputs["Color"], second)
        color = next(socket for socket in mix.outputs if socket.type == "RGBA")
    links.new(color, principled.inputs["Base Color"])
    return material


def emission(name: str, color: Sequence[float], strength: float) -> bpy.types.Material:
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    principled = next(node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    principled.inputs["Base Color"].default_value = (*color, 1)
    principled.inputs["Emission Color"].default_value = (*color, 1)
    principled.inputs["Emission Strength"].default_value = strength
    return material
