"""Traces rays against a triangle mesh with Embree: first hits and occlusion.

Arrays in and out are NumPy float32. Lengths are those of the mesh, normally in the unit frame. Embree computes in single
precision, so the offset from the surface scales with the mesh.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import torch
from embreex import rtcore_scene
from embreex.mesh_construction import TriangleMesh

from blender_nep.profiling import profiled

_CHUNK = 1 << 16
"""Rays in a task: so many that the call costs little, and so few that threads can share the work."""


class RayTracer:
    """First-hit queries against one triangle mesh (two-sided).

    vertices [V, 3], faces [F, 3]. Raises ValueError when the mesh is empty or has vertices that are not finite.
    """

    def __init__(self, vertices: np.ndarray, faces: np.ndarray):
        vertices = np.ascontiguousarray(vertices, np.float32)
        faces = np.ascontiguousarray(faces, np.int32)
        if len(faces) == 0 or len(vertices) == 0:
            raise ValueError("a ray tracer needs at least one triangle")
        if not np.isfinite(vertices).all():
            raise ValueError("mesh vertices are not finite")
        self.vertices, self.faces = vertices, faces
        used = vertices[faces.ravel()]
        self.scale = float(max(np.abs(used).max(), np.ptp(used, axis=0).max(), 1e-20))
        self.offset = 1e-5 * self.scale
        """Distance by which `leave` lifts a ray off the surface: about a hundred units in the last place of a coordinate."""
        corner = vertices[faces].astype(np.float64)
        normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        self.face_normals = (normal / np.maximum(length, 1e-300)).astype(np.float32)
        self._scene = rtcore_scene.EmbreeScene()
        self._mesh = TriangleMesh(scene=self._scene, vertices=vertices, indices=faces)
        # Embree builds its tree at the first query. This query does it before several threads ask at once.
        self._scene.run(np.zeros((1, 3), np.float32), np.array([[0, 0, 1]], np.float32))
        self._threads = torch.get_num_threads()

    @profiled("ray tracing")
    def intersect(self, origins: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The first hit of each ray. origins, directions [n, 3]; distances are in units of the directions' length.

        Returns distance t [n] float32 (inf on a miss), face [n] int32 (-1 on a miss), barycentric [n, 3] float32 (weights of
        the face's three vertices; zeros on a miss). Raises ValueError for other shapes.
        """
        n = len(origins)
        t = np.empty(n, np.float32)
        face = np.empty(n, np.int32)
        barycentric = np.empty((n, 3), np.float32)

        def work(span: slice, o: np.ndarray, d: np.ndarray) -> None:
            hit = self._scene.run(o, d, output=True)
            miss = hit["primID"] < 0
            t[span] = np.where(miss, np.inf, hit["tfar"])
            face[span] = hit["primID"]
            u, v = hit["u"], hit["v"]
            barycentric[span] = np.where(miss[:, None], 0, np.stack([1 - u - v, u, v], 1))

        self._each_chunk(work, origins, directions)
        return t, face, barycentric

    @profiled("ray tracing")
    def occluded(self, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Whether each ray meets the mesh: [n] bool. origins, directions [n, 3]. Raises ValueError for other shapes."""
        out = np.empty(len(origins), bool)

        def work(span: slice, o: np.ndarray, d: np.ndarray) -> None:
            out[span] = self._scene.run(o, d, query="OCCLUDED") >= 0

        self._each_chunk(work, origins, directions)
        return out

    def leave(self, points: np.ndarray, faces: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Origins [n, 3] for rays along directions [n, 3] that start at points [n, 3] on faces [n].

        The points are lifted along the face normal, to the side of the direction, so that the ray does not hit its own face.
        """
        normal = self.face_normals[faces]
        side = np.where(np.einsum("ij,ij->i", normal, directions) < 0, -self.offset, self.offset)
        return (points + normal * side[:, None]).astype(np.float32)

    def interpolate(self, attribute: np.ndarray, faces: np.ndarray, barycentric: np.ndarray) -> np.ndarray:
        """A vertex attribute [V, k] interpolated at surface points (faces [n], barycentric [n, 3]): [n, k]."""
        return np.einsum("nc,nck->nk", barycentric, attribute[self.faces[faces]])

    def smooth_normals(self, normals: np.ndarray, faces: np.ndarray, barycentric: np.ndarray) -> np.ndarray:
        """Unit normals [n, 3] float32 at surface points, interpolated from the vertices' normals [V, 3].

        Where the interpolated normal is nearly zero, it is the face normal.
        """
        smooth = self.interpolate(normals, faces, barycentric)
        length = np.linalg.norm(smooth, axis=1, keepdims=True)
        return np.where(length > 1e-6, smooth / np.maximum(length, 1e-6), self.face_normals[faces]).astype(np.float32)

    def _each_chunk(self, work, origins: np.ndarray, directions: np.ndarray) -> None:
        o = np.ascontiguousarray(origins, np.float32)
        d = np.ascontiguousarray(directions, np.float32)
        if o.shape != d.shape or o.ndim != 2 or o.shape[1] != 3:
            raise ValueError(f"origins {o.shape} and directions {d.shape} must both be [n,3]")
        spans = [slice(s, min(s + _CHUNK, len(o))) for s in range(0, len(o), _CHUNK)]
        if len(spans) <= 1:
            for span in spans:
                work(span, o[span], d[span])
            return
        with ThreadPoolExecutor(self._threads) as pool:
            list(pool.map(lambda span: work(span, o[span], d[span]), spans))
