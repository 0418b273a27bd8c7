"""What an object stands on: the sphere cuts a piece out of the table, and that piece must not become a skirt.

The mesh is capped where the sphere cuts it. Where the cap's rim lies in one plane, and the surface that reaches the rim
lies in that plane too, the cut is a table's. A foot or a stand that leaves the sphere meets the rim upright, and stays.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh

TOLERANCE = 0.03
"""Distance from the plane up to which a point lies in it, object radii."""
LEAST_SHARE = 0.6
"""Of the rim, and of the surface near it, that must lie in the plane."""
LEAST_RIM = 0.4
"""Radius of the smallest rim taken for a table's, object radii."""
MARGIN = 0.02
"""The object is cut this far above the plane, object radii."""


@dataclass
class Support:
    """A plane normal . x = height [unit frame], normal [3] towards the object."""

    normal: np.ndarray
    height: float


def find_support(vertices: np.ndarray, faces: np.ndarray, border: float, seed: int = 0) -> Support | None:
    """The support plane of a mesh (vertices [V,3], faces [F,3]) capped at radius `border`, or None."""
    radius = np.linalg.norm(vertices, axis=1)
    cap = (radius[faces] > border - 0.01).all(1)
    if not cap.any() or cap.all():
        return None
    rim = vertices[np.intersect1d(faces[cap], faces[~cap])]
    plane = _fit(rim, np.random.default_rng(seed))
    if plane is None:
        return None
    normal, height = plane.normal, plane.height
    if np.sqrt(max(border**2 - height**2, 0.0)) < LEAST_RIM:
        return None
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    near = ~cap & (radius[faces].mean(1) > 0.85 * border)
    area = mesh.area_faces[near]
    flat = np.abs(mesh.triangles_center[near] @ normal - height) < TOLERANCE
    up = mesh.face_normals[near] @ normal
    if area.sum() == 0 or (area * (flat & (up > 0.8))).sum() < LEAST_SHARE * area.sum():
        return None
    return plane


def _fit(points: np.ndarray, rng: np.random.Generator, tries: int = 200) -> Support | None:
    """RANSAC: the plane that holds most points, its normal towards the origin's side of a cut below the centre."""
    best, most = None, 0
    if len(points) < 12:
        return None
    for _ in range(tries):
        a, b, c = points[rng.choice(len(points), 3, replace=False)]
        normal = np.cross(b - a, c - a)
        length = np.linalg.norm(normal)
        if length < 1e-3:
            continue
        normal = normal / length
        inside = np.abs((points - a) @ normal) < TOLERANCE
        if inside.sum() > most:
            best, most = inside, inside.sum()
    if best is None or most < LEAST_SHARE * len(points):
        return None
    centre = points[best].mean(0)
    normal = np.linalg.svd(points[best] - centre, full_matrices=False)[2][2]
    height = float(normal @ centre)
    return Support(-normal, -height) if height > 0 else Support(normal, height)
