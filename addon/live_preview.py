"""What a running job has learned so far: a mesh in the viewport, and a picture in the panel.

Undo and File > New may remove the mesh at any moment. So it is found each time by its custom property JOB_PROPERTY.
"""

import zipfile
from pathlib import Path

import bpy
import bpy.utils.previews
import numpy as np

NAME = "NeP preview"
JOB_PROPERTY = "nep_preview_of"  # the key of the job whose preview the object is
HALVES = ("/photo", "/learned")  # added to the key of the job: the names of a picture's left and right half

_pictures: bpy.utils.previews.ImagePreviewCollection | None = None


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


def remove_meshes(job_key: str) -> None:
    """Remove the job's preview mesh from all scenes."""
    for scene in bpy.data.scenes:
        item = _preview_object(scene, job_key)
        if item is not None:
            bpy.data.meshes.remove(item.data)  # this removes the object too


def _preview_object(scene: bpy.types.Scene, job_key: str) -> bpy.types.Object | None:
    return next((item for item in scene.objects if item.get(JOB_PROPERTY) == job_key and item.type == "MESH"), None)


def load_picture(job_key: str, file: Path) -> None:
    """Load the job's picture for the panel: its left half is a photo, its right half what was learned of it.

    Blender shows a picture as a square. Two halves are then larger than the whole.
    """
    global _pictures
    if _pictures is None:
        _pictures = bpy.utils.previews.new()
    remove_picture(job_key)
    both = _pictures.load(job_key, str(file), "IMAGE", force_reload=True)
    width, height = both.image_size
    if not width:
        return
    pixels = np.empty(4 * width * height, np.float32)
    both.image_pixels_float.foreach_get(pixels)
    halves = np.split(pixels.reshape(height, width, 4)[:, : width // 2 * 2], 2, axis=1)
    for name, half in zip(HALVES, halves, strict=True):
        picture = _pictures.new(job_key + name)
        picture.image_size = half.shape[1], height
        picture.image_pixels_float.foreach_set(half.ravel())


def picture_halves(job_key: str) -> list[bpy.types.ImagePreview]:
    """The job's photo, and what was learned of it; an empty list where no picture is loaded."""
    if _pictures is None or job_key + HALVES[-1] not in _pictures:
        return []
    return [_pictures[job_key + name] for name in HALVES]


def remove_picture(job_key: str) -> None:
    """Remove the job's picture, if there is one."""
    if _pictures is not None:
        for name in ("", *HALVES):
            _pictures.pop(job_key + name, None)


def remove_all_pictures() -> None:
    """Blender or the add-on ends: give all pictures back to Blender."""
    global _pictures
    if _pictures is not None:
        bpy.utils.previews.remove(_pictures)
        _pictures = None
