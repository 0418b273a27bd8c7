"""What a running job has learned so far: a mesh in the viewport, and a picture in the panel.

The mesh is looked up by its mark each time: undo and File > New may have removed it.
"""
import zipfile
from pathlib import Path

import bpy
import bpy.utils.previews
import numpy as np

NAME = "NeP preview"
MARK = "nep_preview_of"

_pictures = None


def show_mesh(scene, job: str, file: Path) -> None:
    """Put the mesh of a preview file into `scene`, in place of the one before. A file that is gone is let be."""
    try:
        with np.load(file) as arrays:
            vertices, faces = arrays["vertices"], arrays["faces"]
    except (OSError, ValueError, KeyError, zipfile.BadZipFile):
        return  # the job was started again, or its folder is gone: the job itself tells of it
    item = _find(scene, job)
    if item is None:
        item = bpy.data.objects.new(NAME, bpy.data.meshes.new(NAME))
        item[MARK] = job
        item.hide_select = item.hide_render = True
        scene.collection.objects.link(item)
    _fill(item.data, vertices, faces)


def _fill(mesh, vertices: np.ndarray, faces: np.ndarray) -> None:
    """New geometry, vertices [n,3] and triangles [m,3]; several times as fast as from_pydata, which makes Python wait."""
    mesh.clear_geometry()
    mesh.vertices.add(len(vertices))
    mesh.vertices.foreach_set("co", np.ascontiguousarray(vertices, np.float32).ravel())
    mesh.loops.add(faces.size)
    mesh.loops.foreach_set("vertex_index", np.ascontiguousarray(faces, np.int32).ravel())
    mesh.polygons.add(len(faces))
    mesh.polygons.foreach_set("loop_start", np.arange(0, faces.size, 3, dtype=np.int32))
    mesh.update(calc_edges=True)
    mesh.shade_smooth()


def remove_meshes(job: str) -> None:
    """The job has ended: its preview goes."""
    for scene in bpy.data.scenes:
        item = _find(scene, job)
        if item is not None:
            bpy.data.meshes.remove(item.data)  # and with it the object


def _find(scene, job: str):
    return next((item for item in scene.objects if item.get(MARK) == job and item.type == "MESH"), None)


def load_picture(job: str, file: Path) -> None:
    """Keep a picture at hand for the panel."""
    global _pictures
    if _pictures is None:
        _pictures = bpy.utils.previews.new()
    _pictures.pop(job, None)
    _pictures.load(job, str(file), "IMAGE", force_reload=True)


def picture_icon(job: str) -> int | None:
    """The icon of a job's picture, for `template_icon`."""
    return _pictures[job].icon_id if _pictures is not None and job in _pictures else None


def forget_picture(job: str) -> None:
    """The job has ended."""
    if _pictures is not None:
        _pictures.pop(job, None)


def close() -> None:
    """Give all pictures back."""
    global _pictures
    if _pictures is not None:
        bpy.utils.previews.remove(_pictures)
        _pictures = None
