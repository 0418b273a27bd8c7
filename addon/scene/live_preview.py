"""What a running job has learned so far, as a mesh in the viewport.

Undo and File > New may remove the mesh at any moment. So it is found each time by its custom property JOB_PROPERTY.
"""

import tokenize
import zipfile
import zlib
from collections.abc import Collection
from pathlib import Path

import bpy
import numpy as np

from ...backend.plain_files import open_plain

NAME = "NeP preview"
JOB_PROPERTY = "nep_preview_of"  # the key of the job whose preview the object is
DAMAGED = (
    *(OSError, ValueError, KeyError, EOFError, MemoryError, zipfile.BadZipFile, zlib.error),
    *(
        AttributeError,
        TypeError,
        SyntaxError,
        tokenize.TokenError,
        RecursionError,
        NotImplementedError,
        RuntimeError,
        OverflowError,
    ),
)  # what numpy and zipfile raise for damaged files
MOST_BYTES = 1 << 29  # of the arrays of a preview: a hundred times as many as the engine writes


def show_mesh(scene: bpy.types.Scene, job_key: str, file: Path) -> None:
    """Show the mesh of a preview file in `scene`, in place of the job's last one.

    An unreadable or damaged file changes nothing, nor does any file while the artist edits the preview.
    """
    try:
        vertices, faces = _read_mesh(file)
    except DAMAGED:
        return  # the job was started again, or its folder is gone: the job itself reports that
    item = _preview_object(scene, job_key)
    if item is None:
        item = bpy.data.objects.new(NAME, bpy.data.meshes.new(NAME))
        item[JOB_PROPERTY] = job_key
        item.hide_select = item.hide_render = True
        scene.collection.objects.link(item)
    if not _is_being_edited(item):
        _replace_geometry(item.data, vertices, faces)


def _read_mesh(file: Path) -> tuple[np.ndarray, np.ndarray]:
    """The vertices [n,3] and triangles [m,3] of a preview file. ValueError where they are no mesh.

    The check is needed: Blender ends with a segmentation fault where it draws a triangle of a vertex that is not there.
    """
    with open_plain(file, MOST_BYTES) as opened, np.load(opened) as arrays:
        if sum(part.file_size for part in arrays.zip.infolist()) > MOST_BYTES:
            raise ValueError("the arrays are too large")
        vertices, faces = arrays["vertices"], arrays["faces"]
    for array, kinds in ((vertices, "f"), (faces, "iu")):
        if array.ndim != 2 or array.shape[1] != 3 or array.dtype.kind not in kinds:
            raise ValueError("not of the form [n,3]")
    vertices = vertices.astype(np.float32)  # a large number becomes infinity
    if not np.isfinite(vertices).all() or (faces.size and not 0 <= faces.min() <= faces.max() < len(vertices)):
        raise ValueError("no such vertex")
    return vertices, faces


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
    mesh.validate()  # without it, Blender hangs in Edit Mode where a triangle has a vertex twice
    mesh.shade_smooth()


def remove_meshes_except(job_keys: Collection[str]) -> bool:
    """Remove the preview meshes of all jobs but these from the file. Returns whether some are left, because they are edited.

    A mesh may come from a job that ended while the file was closed, or from an undo step.
    """
    left = False
    for item in [item for item in bpy.data.objects if item.get(JOB_PROPERTY, "") not in {"", *job_keys}]:
        if item.type == "MESH" and _is_being_edited(item):
            left = True
        elif item.type == "MESH":
            bpy.data.meshes.remove(item.data)  # this removes the object too
    return left


def _is_being_edited(item: bpy.types.Object) -> bool:
    """Whether the mesh is in Edit Mode or such. If it were removed then, the next undo would end Blender with a crash."""
    return item.mode != "OBJECT" or item.data.is_editmode


def _preview_object(scene: bpy.types.Scene, job_key: str) -> bpy.types.Object | None:
    return next((item for item in scene.objects if item.get(JOB_PROPERTY) == job_key and item.type == "MESH"), None)
