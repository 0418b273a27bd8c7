"""Tells which parts of the mesh the photos show. What no photo shows, such as the foot on a table, has no confidence."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch

from blender_nep.capture.rays.pixel_rays import PixelRays
from blender_nep.evidence.observation import visible
from blender_nep.evidence.occluders import MeshOccluder
from blender_nep.geometry.mesh import Surface
from blender_nep.geometry.ray_tracing import RayTracer
from blender_nep.profiling import profiled

_PART = 0.04
"""Longest edge of a part of a face, in object radii. Most faces of a learned mesh are smaller, and one part each. Those of a
given mesh may be large: a photo may show one end of a wall alone."""
_MOST = 500_000
"""Largest number of parts, about. If there are more, because of many long thin faces, parts are larger."""


class ShownParts(NamedTuple):
    """Which parts of F faces the photos show. The edges of face f are divided into k = edge_parts[f], the face into k^2."""

    edge_parts: np.ndarray
    """[F] int"""
    shown: np.ndarray
    """[P] bool: whether a photo shows the center of each part; the parts of the first face come first"""

    @classmethod
    def of(cls, surface: Surface, tracer: RayTracer, rays: PixelRays) -> ShownParts:
        """Ask the photos. A part's face must look towards the camera, and its center must be in the frame and not hidden.

        `tracer` holds the faces of `surface`.
        """
        edge_parts, face, barycentric = _parts(surface)
        center = np.einsum("pc,pck->pk", barycentric, surface.vertices[surface.faces[face]]).astype(np.float32)
        return cls(edge_parts, _shown(center, face, tracer, rays))

    def at(self, face: np.ndarray, barycentric: np.ndarray) -> np.ndarray:
        """Whether a photo shows the part that holds each of n places: [n] bool. face [n] int, barycentric [n, 3]."""
        first = np.cumsum(self.edge_parts**2) - self.edge_parts**2
        k = self.edge_parts[face]
        row, column = (np.minimum((barycentric[:, c] * k).astype(np.int64), k - 1) for c in (0, 1))
        column = np.minimum(column, k - 1 - row)
        inverted = (barycentric[:, :2] * k[:, None]).sum(1) - row - column > 1
        inverted &= column < k - 1 - row
        return self.shown[first[face] + 2 * k * row - row**2 + 2 * column + inverted]


def _parts(surface: Surface) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The number of parts along the edges [F] of each face; the face [P] of each part, and its center: barycentric [P, 3].

    Row r of a face with k rows has 2 (k - r) - 1 parts: upright and inverted triangles in turn.
    """
    corner = surface.vertices[surface.faces]
    longest = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).max(1)
    edge_parts = np.maximum(np.ceil(longest / _PART), 1)
    fewer = np.sqrt(_MOST / max((edge_parts**2).sum(), 1))
    edge_parts = np.maximum(edge_parts * min(fewer, 1), 1).astype(np.int64)
    face = np.repeat(np.arange(len(edge_parts)), edge_parts**2)
    k = edge_parts[face]
    number = np.arange(len(face)) - np.repeat(np.cumsum(edge_parts**2) - edge_parts**2, edge_parts**2)
    row = k - np.ceil(np.sqrt(k**2 - number)).astype(np.int64)
    column, inverted = np.divmod(number - (2 * k * row - row**2), 2)
    a, b = ((place + (1 + inverted) / 3) / k for place in (row, column))
    return edge_parts, face, np.stack([a, b, 1 - a - b], 1)


@profiled("shown faces")
def _shown(center: np.ndarray, face: np.ndarray, tracer: RayTracer, rays: PixelRays) -> np.ndarray:
    """Whether a photo shows each point `center` [P, 3] of the faces [P]: [P] bool."""
    shown, device = np.zeros(len(center), bool), rays.radiance.device
    for view in range(rays.views):
        left = np.flatnonzero(~shown)
        points, normals = (torch.from_numpy(part).to(device) for part in (center[left], tracer.face_normals[face[left]]))
        # every angle counts: what a photo shows at all is not invented
        seen = visible(rays, view, points, normals, MeshOccluder(tracer, faces=face[left]), least_cosine=0.0)
        shown[left[seen.index.cpu().numpy()]] = True
    return shown
