"""The surface as a triangle mesh, and its normals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh

from blender_nep.safety.arrays import check_array

_CANCELLED = 1e-3
"""Length of a sum of unit normals, each weighted by an angle in radians, that says no direction"""


@dataclass
class Surface:
    """A triangle mesh in the unit frame; vertices are split at the seams of the UV map."""

    vertices: np.ndarray
    """[V, 3] float64"""
    faces: np.ndarray
    """[F, 3] int64, counter-clockwise seen from outside"""
    normals: np.ndarray
    """[V, 3] float64, smooth, unit length, outward"""
    uv: np.ndarray | None = None
    """[V, 2] in 0..1, v upwards; None before unwrapping"""

    def check(self) -> None:
        """Raises ValueError unless all arrays fit each other, and every face is one of vertices that are there."""
        count = check_array("vertices", self.vertices, (None, 3))
        if not check_array("faces", self.faces, (None, 3), low=0, high=count - 1):
            raise ValueError("there are no faces")
        check_array("normals", self.normals, (count, 3))
        if self.uv is not None:
            check_array("uv", self.uv, (count, 2), low=-1e-3, high=1 + 1e-3)

    @property
    def atlas(self) -> np.ndarray:
        """The UV coordinates [V, 2] of an unwrapped surface. Raises ValueError before unwrapping."""
        if self.uv is None:
            raise ValueError("the surface is not unwrapped")
        return self.uv


def weld(
    vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Merge coincident vertices, and drop degenerate and duplicate faces. Returns vertices [V, 3], faces [F, 3], normals.

    With normals [V, 3], vertices are merged only where they agree.
    """
    if normals is None:
        mesh = trimesh.Trimesh(vertices, faces, process=False)
        mesh.merge_vertices(merge_tex=True, merge_norm=True)
    else:
        place = same_places(vertices)[1]
        key = np.concatenate([place[:, None], np.round(1e3 * normals)], 1)
        _, first, merged = np.unique(key, axis=0, return_index=True, return_inverse=True)
        mesh = trimesh.Trimesh(vertices[first], merged.ravel()[faces], process=False)
        mesh.vertex_attributes["normal"] = normals[first]
    mesh.update_faces(mesh.nondegenerate_faces(height=1e-9) & mesh.unique_faces())
    mesh.remove_unreferenced_vertices()
    kept = None if normals is None else np.asarray(mesh.vertex_attributes["normal"], np.float64)
    return np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64), kept


def same_places(vertices: np.ndarray) -> tuple[int, np.ndarray]:
    """The number of different places of vertices [V, 3], and the number [V] int64 of each vertex's place."""
    scaled = vertices / max(np.abs(vertices).max(), 1e-20)
    places, place = np.unique(np.round(scaled * 1e7), axis=0, return_inverse=True)
    return len(places), place.ravel()


def angle_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit normals [V, 3]: means of the faces' normals, weighted by the angle that a face has at the vertex.

    Blender shades smooth meshes with these normals (Thuermer and Wuethrich 1998). Vertices at the same place have the same
    normal, so that UV seams do not show. Where the faces at a place cancel, as those of the two sides of a sheet do, each
    vertex has the normal of its own faces.
    """
    count, place = same_places(vertices)
    weighted = _weighted_normals(vertices, faces, place, count)[place]
    cancelled = np.linalg.norm(weighted, axis=1) < _CANCELLED
    if cancelled.any():
        weighted[cancelled] = own_normals(vertices, faces)[cancelled]
    return normalized(weighted)


def own_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """As `angle_normals`, but of each vertex's own faces alone: vertices that are split at a hard edge do not share them."""
    return normalized(_weighted_normals(vertices, faces, np.arange(len(vertices)), len(vertices)))


def _weighted_normals(vertices: np.ndarray, faces: np.ndarray, place: np.ndarray, count: int) -> np.ndarray:
    """Sums [count, 3] of the normals of the faces at each place, weighted by angle. place [V] is that of each vertex."""
    corner = vertices[faces] / max(np.abs(vertices).max(), 1e-20)
    face_normal = normalized(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]))
    angle = trimesh.triangles.angles(corner)
    return trimesh.geometry.weighted_vertex_normals(count, place[faces], face_normal, angle)


def normalized(vectors: np.ndarray) -> np.ndarray:
    """`vectors` [..., 3] scaled to unit length; a zero vector becomes (0, 0, 1)."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(length > 1e-30, vectors / np.maximum(length, 1e-30), np.array([0.0, 0.0, 1.0]))
