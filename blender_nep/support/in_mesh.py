"""Finds the support plane on which an object stands, such as a table.

The object's sphere contains a piece of the table, which must not become a part of the mesh. The mesh is capped where the
sphere cuts it. If the rim of the cap lies in one plane, and the surface near the rim lies in that plane too, the sphere cuts
a table. A foot or a stand that leaves the sphere meets the rim upright; it is kept.
"""

from __future__ import annotations

import numpy as np
import trimesh

from blender_nep.support.plane import Support

TOLERANCE = 0.03
"""A point up to this far from the plane counts as lying in it; in object radii."""
LEAST_SHARE = 0.6
"""Smallest share of the rim, and of the surface near the rim, that must lie in the plane."""
LEAST_RIM = 0.4
"""Smallest radius of the rim of a table, in object radii."""
MARGIN = 0.02
"""Up to this far above the plane, in object radii, the surface may be that of the support instead of the object."""


def support_in_mesh(vertices: np.ndarray, faces: np.ndarray, border: float, seed: int = 0) -> Support | None:
    """The support plane of a mesh (vertices [V, 3], faces [F, 3]) that is capped at radius `border`; None without one."""
    radius = np.linalg.norm(vertices, axis=1)
    cap = (radius[faces] > border - 0.01).all(1)
    if not cap.any() or cap.all():
        return None
    rim = vertices[np.intersect1d(faces[cap], faces[~cap])]
    plane = _fit(rim, np.random.default_rng(seed))
    if plane is None:
        return None
    if np.sqrt(max(border**2 - plane.height**2, 0.0)) < LEAST_RIM:
        return None
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    near = ~cap & (radius[faces].mean(1) > 0.85 * border)
    area = mesh.area_faces[near]
    center = mesh.triangles_center[near]
    flat = (np.abs(plane.distance(center)) < TOLERANCE) & (mesh.face_normals[near] @ plane.normal > 0.8)
    if area.sum() == 0 or area[flat].sum() < LEAST_SHARE * area.sum():
        return None
    # the rim is rounded, and so a little lower than the table: the faces beside it tell the height
    level = (mesh.face_normals[near] @ plane.normal > 0.98) & flat
    return _plane_through(center[level]) if level.sum() >= 3 else plane


def _fit(points: np.ndarray, rng: np.random.Generator, tries: int = 200) -> Support | None:
    """The plane that contains most points [n, 3], by RANSAC. Its normal points towards the origin (height <= 0).

    None if fewer than 12 points are given, or if less than LEAST_SHARE of them lie in the plane.
    """
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
    return _plane_through(points[best])


def _plane_through(points: np.ndarray) -> Support:
    """The plane nearest to points [n, 3] in the least-squares sense. Its normal points towards the origin (height <= 0)."""
    center = points.mean(0)
    normal = np.linalg.svd(points - center, full_matrices=False)[2][2]
    height = float(normal @ center)
    return Support(-normal, -height) if height > 0 else Support(normal, height)
