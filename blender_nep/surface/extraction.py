"""Extracts one clean mesh with normals and UVs from the object field F_o."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import fast_simplification
import numpy as np
import torch
import trimesh
from scipy.ndimage import map_coordinates
from skimage import measure

from blender_nep.errors import LearningError
from blender_nep.geometry.mesh import Surface, angle_normals, normalized, weld
from blender_nep.profiling import profiled, section
from blender_nep.support.in_mesh import MARGIN, support_in_mesh
from blender_nep.support.plane import Support
from blender_nep.surface.normal_map import LeanMesh, lean_mesh
from blender_nep.surface.subdivision import subdivide
from blender_nep.surface.unwrap import unwrap

if TYPE_CHECKING:
    from blender_nep.fields.object.field import ObjectField
    from blender_nep.presets import SurfacePreset

_LEAST_PART = 0.05
"""A component with this share of the largest one's area is a part of the object, and no floater."""
_BORDER = 0.995
"""The surface is cropped and capped at this radius. It lies just inside the unit sphere, the border between F_o and F_e."""
_AT_BORDER = 0.001
"""Marching cubes puts the vertices of a cap on its sphere as exactly as this, in object radii: a grid of 192 samples has an
error of 0.00002."""


class Extracted(NamedTuple):
    """The mesh of an object field."""

    surface: Surface
    """The mesh on which materials are learned"""
    report: dict
    lean: LeanMesh | None
    """The mesh of the asset, if it is to have fewer faces"""
    support: Support | None
    """The plane on which the object stands and at which the mesh is cut; None without one"""


def extract_surface(object_field: ObjectField, preset: SurfacePreset, known: Support | None = None) -> Extracted:
    """Make one clean, unwrapped mesh of the SDF's zero level inside the unit sphere.

    The mesh of marching cubes is decimated and unwrapped, and then made finer where the surface bends. It may have
    `relief_faces` if the SDF has relief that is finer than its grid.

    An object on a support plane is cut off there, and its foot is closed flat. The plane is `known` from the photos; else it
    is looked for in the mesh.

    Raises LearningError when the field has no surface in the sphere, or is not finite.
    """
    if object_field.fine is not None:
        preset = replace(preset, faces=preset.relief_faces)
    with section("SDF grid"):
        sdf = object_field.sdf_grid(preset.grid)
    vertices, faces = zero_level(sdf if known is None else _above(sdf, known))
    support = known or support_in_mesh(vertices, faces, _BORDER)
    if support is not None and known is None:
        vertices, faces = zero_level(_above(sdf, support))
    vertices, faces, report = keep_object(vertices, faces)
    report["cut_by_sphere"] = round(_share_at_border(vertices, faces), 4)
    if support is not None:
        report["cut_support_plane"] = support.state()
    report["faces_marching_cubes"] = len(faces)
    unwrapped_faces = min(preset.unwrapped_faces, preset.asset_faces or preset.unwrapped_faces)
    if len(faces) > unwrapped_faces:
        vertices, faces = _decimate(vertices, faces, unwrapped_faces)
        # decimation may move a vertex a little outside the sphere at which the surface was cropped
        vertices *= np.minimum(1, _BORDER / np.maximum(np.linalg.norm(vertices, axis=1, keepdims=True), 1e-9))
    vertices, faces, _ = weld(vertices, faces)
    report["faces_unwrapped"] = len(faces)
    report["watertight"] = bool(trimesh.Trimesh(vertices, faces, process=False).is_watertight)
    normals = _field_normals(object_field, vertices, faces)
    unwrapped = unwrap(Surface(vertices, faces, normals), preset)
    surface = subdivide(unwrapped, object_field, preset, _BORDER, support)
    report["faces"] = len(surface.faces)
    lean = None
    if 0 < preset.asset_faces < len(surface.faces):
        few = subdivide(unwrapped, object_field, replace(preset, faces=preset.asset_faces), _BORDER, support)
        lean, error = lean_mesh(few, surface, preset.normal_texels)
        report |= {"faces": len(few.faces), "faces_learned_on": len(surface.faces)}
        report["normals_without_map_deg"] = round(error, 2)
    return Extracted(surface, report, lean, support)


@profiled("keep the object")
def keep_object(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, dict]:
    """Keep the connected component with the largest area and other large ones, and turn their faces outward.

    A cup beside its saucer are two components. Inner shells and floaters are dropped. vertices [V, 3], faces [F, 3]. The
    report says how much was dropped.
    """
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    labels = trimesh.graph.connected_component_labels(mesh.face_adjacency, node_count=len(faces))
    area = np.bincount(labels, weights=mesh.area_faces)
    # A closed component whose signed volume is opposite to the largest one's is the inner wall of a hollow body.
    corner = vertices[faces]
    volume = np.bincount(labels, weights=np.einsum("ij,ij->i", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])) / 6)
    best = int(area.argmax())
    inner = np.sign(volume) != np.sign(volume[best])
    kept = ~inner & (area >= _LEAST_PART * area[best])
    faces = faces[kept[labels]]
    if volume[best] < 0:
        faces = faces[:, ::-1]
    used, inverse = np.unique(faces, return_inverse=True)
    others = ~kept
    report = {
        "components": len(area),
        "parts": int(kept.sum()),
        "dropped_inner_shells": int(inner.sum()),
        "dropped_floaters": int((others & ~inner).sum()),
        "dropped_area_fraction": round(float(area[others].sum() / area.sum()), 4),
    }
    return vertices[used], inverse.reshape(-1, 3).astype(np.int64), report


def _share_at_border(vertices: np.ndarray, faces: np.ndarray) -> float:
    """The share of the area of a mesh (vertices [V, 3], faces [F, 3]) that is a cap at the sphere's border: 0..1."""
    area = trimesh.Trimesh(vertices, faces, process=False).area_faces
    at_border = (np.linalg.norm(vertices, axis=1) > _BORDER - _AT_BORDER)[faces].all(1)
    return float(area[at_border].sum() / area.sum())


@profiled("marching cubes")
def zero_level(sdf: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Marching cubes on an SDF [n, n, n] over [-1, 1]^3. Returns vertices [V, 3] float64 and faces [F, 3] int64.

    The SDF is first intersected with a sphere of radius _BORDER; where the sphere cuts the surface, it caps the mesh. Raises
    LearningError when the SDF is not finite, or has no surface in the sphere.
    """
    n = sdf.shape[0]
    if not np.isfinite(sdf).all():
        hint = "Try another --seed or a milder preset."
        raise LearningError("the object field diverged: its SDF is not finite", hint, "learning.diverged")
    axis = np.linspace(-1, 1, n, dtype=np.float32)
    squared = axis * axis
    radius = np.sqrt(squared[:, None, None] + squared[None, :, None] + squared[None, None, :])
    cropped = np.maximum(sdf, radius - _BORDER)
    hint = (
        "check object_center and object_radius in transforms.json (the sphere must just contain the object), "
        "or use masks, or a longer preset"
    )
    if cropped.min() >= 0:
        raise LearningError("no surface was found: the object field is empty inside the sphere", hint, "learning.no_surface")
    if sdf[radius < _BORDER].max() <= 0:
        raise LearningError("no surface was found: the object field fills the whole sphere", hint, "learning.no_surface")
    vertices, faces, _, _ = measure.marching_cubes(cropped, 0.0)
    return vertices.astype(np.float64) * (2 / (n - 1)) - 1, faces.astype(np.int64)


def _above(sdf: np.ndarray, support: Support) -> np.ndarray:
    """The SDF [n, n, n] of the object alone, which stands on a support plane and ends there with a flat foot.

    Within MARGIN above the plane the SDF may also hold the support, with a fillet to the object. So there it is extrapolated
    linearly, along the plane's normal, from the two layers at MARGIN and at twice MARGIN.
    """
    n = sdf.shape[0]
    axis = np.linspace(-1, 1, n, dtype=np.float32)
    x, y, z = (np.float32(c) * axis for c in support.normal)
    height = x[:, None, None] + y[None, :, None] + z[None, None, :] - np.float32(support.height)
    alone = sdf.astype(np.float32, copy=True)
    low = np.nonzero(height < MARGIN)
    points = np.stack([axis[i] for i in low], 1)
    rise = (MARGIN - height[low])[:, None] * support.normal
    first, second = (
        map_coordinates(sdf, ((points + rise + k * MARGIN * support.normal).T + 1) * (n - 1) / 2, order=1, mode="nearest")
        for k in (0, 1)
    )
    slope = np.clip((first - second) / MARGIN, -1, 1)
    alone[low] = first + slope * (MARGIN - height[low]).clip(0, MARGIN)
    return np.maximum(alone, -height)


@profiled("decimation")
def _decimate(vertices: np.ndarray, faces: np.ndarray, budget: int) -> tuple[np.ndarray, np.ndarray]:
    """Decimate the mesh to about `budget` faces by quadric errors: many where the surface bends, few where it is flat.

    The lowest aggressiveness that meets the budget within 2 % is used, because a high one collapses edges out of order and
    turns faces by degrees. If none meets it, the result of the highest is used.
    """
    vertices, faces = np.ascontiguousarray(vertices, np.float32), np.ascontiguousarray(faces, np.int32)
    for aggressiveness in (2, 3, 5, 7):
        simple, simple_faces = fast_simplification.simplify(vertices, faces, target_count=budget, agg=aggressiveness)
        if len(simple_faces) <= 1.02 * budget:
            break
    return simple.astype(np.float64), simple_faces.astype(np.int64)


def _field_normals(object_field: ObjectField, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit normals [V, 3] from the SDF's gradient. Where it disagrees with the mesh's own normal, the latter is used.

    They disagree at caps and thin folds.
    """
    device = next(object_field.parameters()).device
    field = object_field.normal(torch.as_tensor(vertices, dtype=torch.float32, device=device)).double().cpu().numpy()
    mesh = angle_normals(vertices, faces)
    agree = np.isfinite(field).all(1) & (np.einsum("ij,ij->i", np.nan_to_num(field), mesh) > 0.5)
    return normalized(np.where(agree[:, None], field, mesh))
