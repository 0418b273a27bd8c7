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
SIDES = ("/photo", "/learned")  # of a picture

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
    """Keep a picture at hand for the panel: on its left half the photo, on its right half what was learned.

    Blender shows pictures in squares: two halves are seen larger than the whole.
    """
    global _pictures
    if _pictures is None:
        _pictures = bpy.utils.previews.new()
    forget_picture(job)
    both = _pictures.load(job, str(file), "IMAGE", force_reload=True)
    width, height = both.image_size
    if not width:
        return
    pixels = np.empty(4 * width * height, np.float32)
    both.image_pixels_float.foreach_get(pixels)
    for side, half in zip(SIDES, np.split(pixels.reshape(height, width, 4)[:, : width // 2 * 2], 2, axis=1), strict=True):
        picture = _pictures.new(job + side)
        picture.image_size = half.shape[1], height
        picture.image_pixels_float.foreach_set(half.ravel())


def picture_icons(job: str) -> list[int]:
    """The icons of a job's photo and of what was learned of it, for `template_icon`; none where there is no picture."""
    if _pictures is None or job + SIDES[-1] not in _pictures:
        return []
    return [_pictures[job + side].icon_id for side in SIDES]


def forget_picture(job: str) -> None:
    """The job has ended, or there is a newer one."""
    if _pictures is not None:
        for name in ("", *SIDES):
            _pictures.pop(job + name, None)


def close() -> None:
    """Give all pictures back."""
    global _pictures
    if _pictures is not None:
        bpy.utils.previews.remove(_pictures)
        _pictures = None
