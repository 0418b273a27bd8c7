"""The surface as a triangle mesh, and its normals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh


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

    @property
    def atlas(self) -> np.ndarray:
        """The UV coordinates [V, 2] of an unwrapped surface. Raises ValueError before unwrapping."""
        if self.uv is None:
            raise ValueError("the surface is not unwrapped")
        return self.uv


def weld(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Merge coincident vertices, and drop degenerate and duplicate faces. Returns vertices [V, 3] and faces [F, 3]."""
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    mesh.update_faces(mesh.nondegenerate_faces(height=1e-9) & mesh.unique_faces())
    mesh.remove_unreferenced_vertices()
    return np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)


def angle_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit normals [V, 3]: means of the faces' normals, weighted by the angle that a face has at the vertex.

    Blender shades smooth meshes with these normals (Thuermer and Wuethrich 1998). Vertices at the same place have the same
    normal, so that UV seams do not show.
    """
    vertices = vertices / max(np.abs(vertices).max(), 1e-20)
    _, place = np.unique(np.round(vertices * 1e7), axis=0, return_inverse=True)
    place = place.ravel()
    corner = vertices[faces]
    face_normal = normalized(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]))
    angle = trimesh.triangles.angles(corner)
    weighted = trimesh.geometry.weighted_vertex_normals(place.max() + 1, place[faces], face_normal, angle)
    return normalized(weighted)[place]


def normalized(vectors: np.ndarray) -> np.ndarray:
    """`vectors` [..., 3] scaled to unit length; a zero vector becomes (0, 0, 1)."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(length > 1e-30, vectors / np.maximum(length, 1e-30), np.array([0.0, 0.0, 1.0]))
