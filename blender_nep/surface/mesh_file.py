"""Reads a mesh file that replaces the learned shape (`--mesh`)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import trimesh

from blender_nep.errors import CaptureError
from blender_nep.geometry.mesh import Surface, angle_normals, weld
from blender_nep.surface.unwrap import unwrap

if TYPE_CHECKING:
    from blender_nep.capture.capture import Capture
    from blender_nep.presets import SurfacePreset


def load_surface(mesh_path: Path, capture: Capture, preset: SurfacePreset) -> Surface:
    """Read a mesh file in the capture's coordinates, and bring it to the unit frame.

    A mesh without usable UVs is welded and unwrapped. Raises CaptureError when the file is not usable (`read_mesh`).
    """
    vertices, faces, uv = read_mesh(mesh_path, capture)
    if uv is not None and len(uv) == len(vertices) and np.ptp(uv, axis=0).min() > 0 and uv.min() >= 0 and uv.max() <= 1:
        return Surface(vertices, faces, angle_normals(vertices, faces), np.asarray(uv, np.float64))
    vertices, faces = weld(vertices, faces)
    return unwrap(Surface(vertices, faces, angle_normals(vertices, faces)), preset)


def read_mesh(mesh_path: Path, capture: Capture) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """The vertices [V, 3] of a mesh file in the unit frame, its faces [F, 3] int64, and its UVs [V, 2] if it has any.

    Raises CaptureError when the file cannot be read, holds no triangle or values that are not finite, or lies outside the
    object's sphere.
    """
    path = Path(mesh_path)
    if not path.is_file():
        raise CaptureError(f"there is no mesh file {path}", "Check the path of --mesh.")
    try:
        mesh = trimesh.load(path, process=False, force="mesh", maintain_order=True)
    except MemoryError:
        raise
    except Exception as error:  # its readers raise nearly anything, also that a package for the format is missing
        hint = "Give an OBJ, PLY, STL or glTF file."
        raise CaptureError(f"the mesh {path.name} cannot be read: {error}", hint) from error
    # trimesh may return a point cloud, although force="mesh" asks for a mesh
    if not isinstance(mesh, trimesh.Trimesh) or not _usable(mesh):
        raise CaptureError(f"the mesh {path.name} holds no usable triangle", "Give a triangle mesh of the object.")
    transform = np.asarray(capture.to_unit, np.float64)
    vertices = np.asarray(mesh.vertices, np.float64) @ transform[:3, :3].T + transform[:3, 3]
    if np.linalg.norm(vertices, axis=1).min() > 1:
        raise CaptureError(
            f"the mesh {path.name} lies outside the object's bounding sphere",
            "The mesh must be in the capture's own coordinates, Z up as captured.",
        )
    return vertices, np.asarray(mesh.faces, np.int64), getattr(mesh.visual, "uv", None)


def _usable(mesh: trimesh.Trimesh) -> bool:
    """Whether the mesh has finite vertices, and triangles with some area between vertices that are there."""
    faces, vertices = np.asarray(mesh.faces), np.asarray(mesh.vertices)
    if not len(faces) or not np.isfinite(vertices).all() or faces.min() < 0 or faces.max() >= len(vertices):
        return False
    return bool(mesh.area > 0)
