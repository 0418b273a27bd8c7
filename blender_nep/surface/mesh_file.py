"""Reads a mesh file that replaces the learned shape (`--mesh`)."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import trimesh

from blender_nep.errors import CaptureError
from blender_nep.geometry.mesh import Surface, angle_normals, normalized, own_normals, weld
from blender_nep.geometry.uv_raster import rasterize
from blender_nep.safety.pictures import forbid_ghostscript
from blender_nep.surface.orientation import outward
from blender_nep.surface.unwrap import unwrap

if TYPE_CHECKING:
    from blender_nep.capture.capture import Capture
    from blender_nep.presets import SurfacePreset

_Y_UP = (".glb", ".gltf")
"""Formats whose Y axis points up. All others are taken as they are, Z up as the capture."""
_FORMATS = (".obj", ".ply", ".stl", ".off", *_Y_UP)
"""What is read. trimesh also knows archives, whose size says nothing of what is in them."""
_WITH_FILES = (".obj", ".ply")
"""Formats that name pictures beside them. They are not needed, and so they are not opened."""
_RASTER = 1024
"""Side of the raster that looks for charts which overlap"""
_OVERLAP = 0.03
"""Share of the charts' area that may be missing in the raster"""
_NOT_UNWRAPPED = 0.01
"""Share of the surface that may have no area in the UV map"""


@dataclass
class GivenMesh:
    """What a mesh file holds, in the unit frame. Vertices are split where their UVs or normals differ."""

    vertices: np.ndarray
    """[V, 3] float64"""
    faces: np.ndarray
    """[F, 3] int64"""
    uv: np.ndarray | None
    """[V, 2], if the file has a UV map"""
    normals: np.ndarray | None
    """[V, 3] unit vectors, if the file has normals. Only they say which edges are hard."""


def load_surface(mesh_path: Path, capture: Capture, preset: SurfacePreset) -> tuple[Surface, dict[str, float | bool]]:
    """Read a mesh file in the capture's coordinates, bring it to the unit frame, and turn its faces outward.

    Its normals count if it has any. Its UV map is kept if every point of the surface has a place of its own there; otherwise
    the mesh is unwrapped. Returns the surface and a report: `turned_fraction` of its area, `own_normals`, `own_uv_map`.
    Raises CaptureError when the file is not usable (`read_mesh`).
    """
    mesh = read_mesh(mesh_path, capture)
    eyes = _to_unit(np.stack([view.camera.position for view in capture.views]), capture)
    faces, turned = outward(mesh.vertices, mesh.faces, eyes)
    own_uv = mesh.uv is not None and _is_atlas(mesh.uv, mesh.vertices, faces)
    report = {"turned_fraction": round(turned, 4), "own_normals": mesh.normals is not None, "own_uv_map": own_uv}
    vertices, normals = mesh.vertices, mesh.normals
    if not own_uv:
        vertices, faces, normals = weld(vertices, faces, normals)
    if normals is None:
        normals = angle_normals(vertices, faces)
    else:  # a mesh that is inside out often has normals that point inwards, too
        inward = (normals * own_normals(vertices, faces)).sum(1, keepdims=True) < 0
        normals = np.where(inward, -normals, normals)
    surface = Surface(vertices, faces, normals)
    if not own_uv:
        return unwrap(surface, preset), report
    surface.uv = mesh.uv
    return surface, report


def read_mesh(mesh_path: Path, capture: Capture) -> GivenMesh:
    """The content of a mesh file in the capture's coordinates. A glTF file is turned from Y up to Z up.

    Raises CaptureError when the file cannot be read, holds no triangle or values that are not finite, or lies outside the
    object's sphere.
    """
    path = Path(mesh_path)
    if not path.is_file():
        raise CaptureError(f"there is no mesh file {path}", "Check the path of --mesh.")
    try:
        mesh = _joined(_scene(path))
    except MemoryError:
        raise
    except Exception as error:  # its readers raise nearly anything, also that a package for the format is missing
        hint = "Give an OBJ, PLY, STL or glTF file."
        raise CaptureError(f"the mesh {path.name} cannot be read: {error}", hint) from error
    if mesh is None or not _usable(mesh.vertices, mesh.faces):
        raise CaptureError(f"the mesh {path.name} holds no usable triangle", "Give a triangle mesh of the object.")
    if path.suffix.lower() in _Y_UP:
        mesh.vertices, mesh.normals = _z_up(mesh.vertices), None if mesh.normals is None else _z_up(mesh.normals)
    mesh.vertices = _to_unit(mesh.vertices, capture)
    if np.linalg.norm(np.concatenate([mesh.vertices, mesh.vertices[mesh.faces].mean(1)]), axis=1).min() > 1:
        raise CaptureError(
            f"the mesh {path.name} lies outside the object's bounding sphere",
            "The mesh must be in the capture's own coordinates, Z up as captured.",
        )
    return mesh


def _scene(path: Path) -> trimesh.Scene:
    ending = path.suffix.lower()
    if ending not in _FORMATS:
        raise ValueError(f"its ending is {ending or 'missing'}")
    forbid_ghostscript()
    options: dict[str, Any] = {"skip_materials": True} if ending in _WITH_FILES else {}
    return trimesh.load_scene(path, process=False, **options)


def _joined(scene: trimesh.Scene) -> GivenMesh | None:
    """All meshes of a file as one, in the file's coordinates; None if it has none. trimesh itself would lose the normals."""
    parts = []
    for node in scene.graph.nodes_geometry:
        place, name = scene.graph[node]
        mesh = scene.geometry[name]
        if not isinstance(mesh, trimesh.Trimesh) or not len(mesh.faces):
            continue  # points or lines
        # A mesh that was just loaded has the file's normals where it later keeps those that it computes.
        normals = np.asarray(mesh.vertex_normals, np.float64) if "vertex_normals" in mesh._cache.cache else None
        uv, turn = getattr(mesh.visual, "uv", None), np.asarray(place, np.float64)[:3, :3]
        faces = np.asarray(mesh.faces, np.int64)
        parts.append(
            GivenMesh(
                np.asarray(mesh.vertices, np.float64) @ turn.T + place[:3, 3],
                faces[:, ::-1] if np.linalg.det(turn) < 0 else faces,
                None if uv is None or len(uv) != len(mesh.vertices) else np.asarray(uv, np.float64),
                None if normals is None or not np.isfinite(normals).all() else normalized(normals @ np.linalg.inv(turn)),
            )
        )
    if not parts:
        return None
    first = np.cumsum([0, *(len(part.vertices) for part in parts[:-1])])

    def of_all(values: list[np.ndarray | None]) -> np.ndarray | None:
        known = [value for value in values if value is not None]
        return np.concatenate(known) if len(known) == len(values) else None

    return GivenMesh(
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([part.faces + start for part, start in zip(parts, first, strict=True)]),
        of_all([part.uv for part in parts]),
        of_all([part.normals for part in parts]),
    )


def _to_unit(points: np.ndarray, capture: Capture) -> np.ndarray:
    transform = np.asarray(capture.to_unit, np.float64)
    return points @ transform[:3, :3].T + transform[:3, 3]


def _usable(vertices: np.ndarray, faces: np.ndarray) -> bool:
    """Whether the mesh has finite vertices, and triangles with some area between vertices that are there."""
    if not np.isfinite(vertices).all() or faces.min() < 0 or faces.max() >= len(vertices):
        return False
    return bool(trimesh.triangles.area(vertices[faces]).sum() > 0)


def _z_up(vectors: np.ndarray) -> np.ndarray:
    return np.stack([vectors[:, 0], -vectors[:, 2], vectors[:, 1]], 1)


def _is_atlas(uv: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> bool:
    """Whether the UV map uv [V, 2] gives every point of the surface a place of its own in the unit square."""
    if not np.isfinite(uv).all() or uv.min() < 0 or uv.max() > 1:
        return False
    flat, corner = uv[faces], vertices[faces]
    side, up = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    mapped = 0.5 * np.abs(side[:, 0] * up[:, 1] - side[:, 1] * up[:, 0])
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    if area[mapped < 1e-12].sum() > _NOT_UNWRAPPED * area.sum():
        return False
    covered = (rasterize(uv, faces, _RASTER)[0] >= 0).mean()
    return bool(covered > (1 - _OVERLAP) * mapped.sum())
