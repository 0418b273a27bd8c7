"""Turns the faces of a given mesh outward. Programs write some meshes inside out."""

from __future__ import annotations

import numpy as np
import trimesh

from blender_nep.geometry.mesh import same_places
from blender_nep.geometry.ray_tracing import RayTracer
from blender_nep.profiling import profiled

_EYES = 16
"""Cameras that are asked, spread over all of them. Few are enough: a part of the mesh has many faces."""
_FACES = 50_000
"""Faces that are asked"""


@profiled("turn faces outward")
def outward(vertices: np.ndarray, faces: np.ndarray, eyes: np.ndarray) -> tuple[np.ndarray, float]:
    """The faces [F, 3], counter-clockwise seen from outside, and the share of the area that was turned.

    vertices [V, 3]; eyes [C, 3] are the positions of the cameras. Cameras see the outer side of an object. So each connected
    part is turned if they see more of its faces from behind. For a part that they do not see, the sign of its volume counts.
    """
    _, place = same_places(vertices)
    corners = place[faces]
    mesh = trimesh.Trimesh(vertices[np.unique(place, return_index=True)[1]], corners, process=False)
    if not mesh.is_winding_consistent:
        trimesh.repair.fix_winding(mesh)
    changed = (np.asarray(mesh.faces) != corners).any(1)
    faces = np.where(changed[:, None], faces[:, ::-1], faces)
    part = trimesh.graph.connected_component_labels(mesh.face_adjacency, node_count=len(faces))
    vote = _votes(vertices, faces, part, eyes)
    corner = vertices[faces]
    volume = np.bincount(part, np.einsum("ij,ij->i", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])))
    turned = np.where(vote == 0, volume < 0, vote < 0)[part]
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    share = float(area[turned ^ changed].sum() / area.sum())
    return np.where(turned[:, None], faces[:, ::-1], faces), share


def _votes(vertices: np.ndarray, faces: np.ndarray, part: np.ndarray, eyes: np.ndarray) -> np.ndarray:
    """For each part [P]: the number of faces that cameras see from the front, less those that they see from behind."""
    tracer = RayTracer(vertices, faces)
    asked = np.arange(len(faces))
    if len(faces) > _FACES:
        asked = np.sort(np.random.default_rng(0).choice(len(faces), _FACES, replace=False))
    center = vertices[faces[asked]].mean(1).astype(np.float32)
    vote = np.zeros(part.max() + 1)
    for eye in eyes[np.linspace(0, len(eyes) - 1, min(_EYES, len(eyes))).round().astype(int)]:
        direction = center - eye.astype(np.float32)
        _, hit, _ = tracer.intersect(np.broadcast_to(eye, direction.shape), direction)
        front = np.einsum("ij,ij->i", tracer.face_normals[asked], direction) < 0
        seen = hit == asked
        vote += np.bincount(part[asked[seen]], np.where(front, 1.0, -1.0)[seen], minlength=len(vote))
    return vote
