"""A lean mesh for the asset, and the tangent-space normal map that carries what the lean mesh does not have.

The lean mesh and the mesh on which materials were learned have the same UV map, so they share all textures. Tangents are
those of MikkTSpace (Mikkelsen 2008, "Simulation of Wrinkled Surfaces Revisited"), as Blender and glTF viewers compute them.
The map is that of OpenGL: red, green and blue are along the tangent (growing u), the bitangent (growing v) and the normal.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from blender_nep.geometry.mesh import Surface, normalized
from blender_nep.geometry.uv_raster import nearest_known, rasterize
from blender_nep.profiling import profiled


@dataclass
class LeanMesh:
    """A mesh of few faces, and its normal map."""

    surface: Surface
    normal_map: np.ndarray
    """[S, S, 3] float32 in 0..1; 0.5, 0.5, 1 is the mesh's own normal"""


@profiled("normal map")
def lean_mesh(lean: Surface, fine: Surface, size: int) -> tuple[LeanMesh, float]:
    """The mesh `lean` with a normal map of size^2 texels that shows the normals of `fine`, which has the same UV map.

    Also returns the mean angle in degrees between the normals of both: the error of the lean mesh without the map.
    """
    at_texel, wanted_at = _Texels(lean, size), _Texels(fine, size)
    known = at_texel.known & wanted_at.known
    tangents, handedness = tangent_frames(lean)
    normal, tangent = (at_texel.mean(values, known) for values in (lean.normals, tangents))
    bitangent = at_texel.mean(handedness[:, None], known) * np.cross(normal, tangent)
    wanted = normalized(wanted_at.mean(fine.normals, known))
    # Renderers add up color * (tangent, bitangent, normal), each interpolated and not normalized. So that is inverted here.
    parts = [np.cross(bitangent, normal), np.cross(normal, tangent), np.cross(tangent, bitangent)]
    volume = (tangent * parts[0]).sum(1, keepdims=True)
    color = np.stack([(wanted * part).sum(1) for part in parts], 1)
    usable = np.abs(volume) > 1e-6
    color = normalized(np.where(usable, color / np.where(usable, volume, 1), (0.0, 0.0, 1.0)))
    texture = np.zeros((size, size, 3), np.float32)
    texture[known] = 0.5 + 0.5 * color
    cosine = (normalized(normal) * wanted).sum(1).clip(-1, 1)
    error = float(np.degrees(np.arccos(cosine)).mean()) if known.any() else 0.0
    return LeanMesh(lean, texture[nearest_known(known)]), error


def tangent_frames(surface: Surface) -> tuple[np.ndarray, np.ndarray]:
    """Unit tangents [V, 3] of an unwrapped surface, and the handedness [V] of its UV map there.

    The tangent is the direction of growing u, at right angles to the vertex normal: the mean over the vertex's faces, each
    weighted by its angle. The handedness is -1 where the UV map is mirrored. The bitangent is handedness * normal x tangent.
    """
    faces, normals = surface.faces, surface.normals
    corner, uv = surface.vertices[faces], surface.atlas[faces]
    side, up = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    along, across = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    area = along[:, 0] * across[:, 1] - along[:, 1] * across[:, 0]
    of_face = np.sign(area)[:, None] * (across[:, 1:] * side - along[:, 1:] * up)
    total, turn = np.zeros_like(normals), np.zeros(len(normals))
    for k in range(3):
        vertex = faces[:, k]
        normal = normals[vertex]
        first, second = (normalized(_flattened(corner[:, (k + step) % 3] - corner[:, k], normal)) for step in (1, 2))
        angle = np.arccos((first * second).sum(1).clip(-1, 1))
        np.add.at(total, vertex, angle[:, None] * normalized(_flattened(of_face, normal)))
        np.add.at(turn, vertex, angle * np.sign(area))
    return normalized(_flattened(total, normals)), np.where(turn < 0, -1.0, 1.0)


def _flattened(vectors: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """The part of vectors [n, 3] at right angles to unit normals [n, 3]."""
    return vectors - (vectors * normals).sum(1, keepdims=True) * normals


class _Texels:
    """The surface points of a square texture's texels."""

    def __init__(self, surface: Surface, size: int) -> None:
        self._corners = surface.faces
        self._face, self._barycentric = rasterize(surface.atlas, surface.faces, size)
        self.known = self._face >= 0
        """[S, S] bool: texels that lie on the surface"""

    def mean(self, values: np.ndarray, texels: np.ndarray) -> np.ndarray:
        """Values [n, C] at the chosen texels [S, S] bool, interpolated from those of the vertices [V, C]."""
        corners = values[self._corners[self._face[texels]]]
        return np.einsum("nk,nkc->nc", self._barycentric[texels], corners)
