"""What a running job has learned so far, as a mesh in the viewport.

Undo and File > New may remove the mesh at any moment. So it is found each time by its custom property JOB_PROPERTY.
"""

import zipfile
from collections.abc import Collection
from pathlib import Path

import bpy
import numpy as np

NAME = "NeP preview"
JOB_PROPERTY = "nep_preview_of"  # the key of the job whose preview the object is


def show_mesh(scene: bpy.types.Scene, job_key: str, file: Path) -> None:
    """Show the mesh of a preview file in `scene`, in place of the job's last one. An unreadable file changes nothing."""
    try:
        with np.load(file) as arrays:
            vertices, faces = arrays["vertices"], arrays["faces"]
    except (OSError, ValueError, KeyError, zipfile.BadZipFile):
        return  # the job was started again, or its folder is gone: the job itself reports that
    item = _preview_object(scene, job_key)
    if item is None:
        item = bpy.data.objects.new(NAME, bpy.data.meshes.new(NAME))
        item[JOB_PROPERTY] = job_key
        item.hide_select = item.hide_render = True
        scene.collection.objects.link(item)
    _replace_geometry(item.data, vertices, faces)


def _replace_geometry(mesh: bpy.types.Mesh, vertices: np.ndarray, faces: np.ndarray) -> None:
    """Give the mesh new vertices [n,3] and triangles [m,3]. This is several times as fast as from_pydata."""
    mesh.clear_geometry()
    mesh.vertices.add(len(vertices))
    mesh.vertices.foreach_set("co", np.ascontiguousarray(vertices, np.float32).ravel())
    mesh.loops.add(faces.size)
    mesh.loops.foreach_set("vertex_index", np.ascontiguousarray(faces, np.int32).ravel())
    mesh.polygons.add(len(faces))
    mesh.polygons.foreach_set("loop_start", np.arange(0, faces.size, 3, dtype=np.int32))
    mesh.update(calc_edges=True)
    mesh.shade_smooth()


def remove_meshes_except(job_keys: Collection[str]) -> None:
    """Remove the preview meshes of all jobs but these from the file.

    A mesh may come from a job that ended while the file was closed, or from an undo step.
    """
    for item in [item for item in bpy.data.objects if item.get(JOB_PROPERTY, "") not in {"", *job_keys}]:
        if item.type == "MESH":
            bpy.data.meshes.remove(item.data)  # this removes the object too


def _preview_object(scene: bpy.types.Scene, job_key: str) -> bpy.types.Object | None:
    return next((item for item in scene.objects if item.get(JOB_PROPERTY) == job_key and item.type == "MESH"), None)
