"""Builds the object of a random scene in the current file of Blender."""

import math
from pathlib import Path

import bmesh
import bpy
import numpy as np
from mathutils import Euler, Matrix, Vector

from . import scenes
from .random_scene import MESH_FILE, SceneDescription, details
from .random_shapes import SHAPES

UPRIGHT = ("vase", "Suzanne", MESH_FILE)
"""Kinds that keep their upper side up where nothing supports them."""
STANDING = ("vase",)
"""Kinds with a foot of their own. The others are laid onto the support as they would rest on it."""
SHARP = math.radians(40)


def build_object(scene: SceneDescription) -> bpy.types.Object:
    """Add the object of the scene, within the sphere of radius 1, with its material.

    On a support the object stands or lies as it would without falling over. Raises ValueError for a mesh file that cannot be
    read.
    """
    rng = details(scene.seed, "object")
    item = _shape(scene, rng)
    scenes.normalize(item)
    _turn(item, scene, rng)
    scenes.normalize(item)
    item.name = item.data.name = "object"
    item.data.materials.clear()
    item.data.materials.append(scenes.object_material(scene.pattern, scene.substances, rng))
    return item


def _shape(scene: SceneDescription, rng: np.random.Generator) -> bpy.types.Object:
    if scene.object == MESH_FILE:
        item = scenes.mesh_file(Path(scene.mesh))
    elif scene.object == "Suzanne":
        bpy.ops.mesh.primitive_monkey_add()
        item = bpy.context.object
        item.modifiers.new("subdivision", "SUBSURF").levels = 3
        # The eyes are open shells of their own. Voxels make one closed surface of them and the head.
        remesh = item.modifiers.new("closed", "REMESH")
        remesh.mode, remesh.voxel_size = "VOXEL", 0.02
        smooth = item.modifiers.new("smooth", "SMOOTH")
        smooth.factor, smooth.iterations = 0.5, 3
        scenes.apply_modifiers(item)
    else:
        item = mesh_object("object", *SHAPES[scene.object](rng))
        if scene.object == "gear":
            _bevel(item)
    item.data.shade_smooth()
    item.data.set_sharp_from_angle(angle=SHARP)
    return item


def mesh_object(name: str, vertices: np.ndarray, faces: list[list[int]]) -> bpy.types.Object:
    """Add a mesh object with these vertices [V,3] and faces to the scene."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(vertices.tolist(), [], faces)
    mesh.update()
    item = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(item)
    return item


def _bevel(item: bpy.types.Object) -> None:
    """Round the edges, as on a part that was cast."""
    bevel = item.modifiers.new("bevel", "BEVEL")
    bevel.width, bevel.segments, bevel.limit_method, bevel.angle_limit = 0.018, 2, "ANGLE", SHARP
    bevel.use_clamp_overlap = True
    scenes.apply_modifiers(item)


def _turn(item: bpy.types.Object, scene: SceneDescription, rng: np.random.Generator) -> None:
    heading = Matrix.Rotation(rng.uniform(0, 2 * math.pi), 4, "Z")
    if scene.support.kind != "none" and scene.object not in STANDING:
        turn = resting_pose(item)
    elif scene.object in (*UPRIGHT, *STANDING):
        turn = Matrix.Identity(4)
    else:
        turn = Euler(rng.uniform(-0.9, 0.9, 3).tolist()).to_matrix().to_4x4()
    item.data.transform(heading @ turn)
    item.data.update()


def resting_pose(item: bpy.types.Object) -> Matrix:
    """The turn that lays the object onto a horizontal plane such that it does not fall over.

    The object rests on the face of the convex hull that is nearest to the center of mass. The hull's own center stands for
    the center of mass. It is the mean of the centers of the hull's faces, weighted by area.
    """
    work = bmesh.new()
    work.from_mesh(item.data)
    hull = bmesh.ops.convex_hull(work, input=work.verts)["geom"]
    faces = [part for part in hull if isinstance(part, bmesh.types.BMFace)]
    normals = np.array([face.normal for face in faces])  # their signs are made right below
    centers = np.array([face.calc_center_median() for face in faces])
    areas = np.array([face.calc_area() for face in faces])
    work.free()
    middle = areas @ centers / areas.sum()
    distance = ((centers - middle) * normals).sum(1)
    usable = areas > 1e-6 * areas.sum()  # the normal of a face without area is not known
    nearest = np.where(usable, np.abs(distance), np.inf).argmin()
    outward = normals[nearest] * np.sign(distance[nearest])
    return Vector(outward.tolist()).rotation_difference(Vector((0, 0, -1))).to_matrix().to_4x4()
