"""From the object field to a mesh with normals and UVs; or from a mesh file (`--mesh`) to the same."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import fast_simplification
import numpy as np
import torch
import trimesh
import xatlas
from skimage import measure

from blender_nep.errors import CaptureError, LearningError
from blender_nep.profiling import profiled, section
from blender_nep.surface.support_plane import MARGIN, Support, find_support

if TYPE_CHECKING:
    from blender_nep.capture.capture import Capture
    from blender_nep.fields.object_field import ObjectField
    from blender_nep.presets import SurfacePreset

_BORDER = 0.995
"""The surface is cropped (and capped) at this radius: just inside the unit sphere that divides F_o from F_e."""


@dataclass
class Surface:
    """A triangle mesh in the unit frame; vertices are split at the seams of the UV map."""

    vertices: np.ndarray
    """[V,3] float64"""
    faces: np.ndarray
    """[F,3] int64, counter-clockwise seen from outside"""
    normals: np.ndarray
    """[V,3] float64, smooth, unit length, outward"""
    uv: np.ndarray | None = None
    """[V,2] in 0..1, v upwards; None before unwrapping"""


def extract_surface(object_field: ObjectField, preset: SurfacePreset) -> tuple[Surface, dict]:
    """The zero level of the SDF inside the unit sphere as one clean, decimated, unwrapped mesh, and a report on it.

    Raises LearningError when the field has no surface in the sphere.
    """
    with section("SDF grid"):
        sdf = object_field.sdf_grid(preset.grid)
    vertices, faces = zero_level(sdf)
    support = find_support(vertices, faces, _BORDER)
    if support is not None:
        vertices, faces = zero_level(_above(sdf, support))
    vertices, faces, report = keep_object(vertices, faces)
    if support is not None:
        report["cut_support_plane"] = {"normal": support.normal.round(3).tolist(), "height": round(support.height, 4)}
    report["faces_marching_cubes"] = len(faces)
    if len(faces) > preset.faces:
        vertices, faces = _decimate(vertices, faces, preset.faces)
        # a quadric's best place may lie a little outside of the sphere that the surface was cropped at
        vertices *= np.minimum(1, _BORDER / np.maximum(np.linalg.norm(vertices, axis=1, keepdims=True), 1e-9))
    vertices, faces = _weld(vertices, faces)
    report["faces"] = len(faces)
    report["watertight"] = bool(trimesh.Trimesh(vertices, faces, process=False).is_watertight)
    normals = _field_normals(object_field, vertices, faces)
    return unwrap(Surface(vertices, faces, normals), preset), report


def load_surface(mesh_path: Path, capture: Capture, preset: SurfacePreset) -> Surface:
    """A mesh file in the capture's coordinates, brought to the unit frame; unwrapped where it has no UVs.

    Raises CaptureError when it cannot be read, holds no triangle, or lies outside the object's sphere.
    """
    path = Path(mesh_path)
    if not path.is_file():
        raise CaptureError(f"there is no mesh file {path}", "check the path given to --mesh")
    try:
        mesh = trimesh.load(path, process=False, force="mesh", maintain_order=True)
    except (ValueError, TypeError, KeyError, IndexError, OSError, NotImplementedError) as error:
        hint = "give an OBJ, PLY, STL or glTF file"
        raise CaptureError(f"the mesh {path.name} cannot be read: {error}", hint) from error
    if len(mesh.faces) == 0 or not np.isfinite(mesh.vertices).all():
        raise CaptureError(f"the mesh {path.name} holds no usable triangle", "give a triangle mesh of the object")
    transform = np.asarray(capture.to_unit, np.float64)
    vertices = np.asarray(mesh.vertices, np.float64) @ transform[:3, :3].T + transform[:3, 3]
    if np.linalg.norm(vertices, axis=1).min() > 1:
        raise CaptureError(
            f"the mesh {path.name} lies outside the object's bounding sphere",
            "the mesh must be in the capture's own coordinates, Z up as captured",
        )
    faces = np.asarray(mesh.faces, np.int64)
    uv = getattr(mesh.visual, "uv", None)
    if uv is not None and len(uv) == len(vertices) and np.ptp(uv, axis=0).min() > 0 and uv.min() >= 0 and uv.max() <= 1:
        return Surface(vertices, faces, _area_normals(vertices, faces), np.asarray(uv, np.float64))
    vertices, faces = _weld(vertices, faces)
    return unwrap(Surface(vertices, faces, _area_normals(vertices, faces)), preset)


@profiled("UV atlas")
def unwrap(surface: Surface, preset: SurfacePreset) -> Surface:
    """The same surface with a UV atlas (xatlas); vertices are duplicated along its seams."""
    atlas = xatlas.Atlas()
    atlas.add_mesh(surface.vertices.astype(np.float32), surface.faces.astype(np.uint32))
    charts = xatlas.ChartOptions()
    charts.max_iterations = 1
    pack = xatlas.PackOptions()
    pack.resolution, pack.padding = preset.atlas_texels, preset.padding_texels
    pack.bruteForce, pack.create_image = False, False
    atlas.generate(charts, pack)
    source, faces, uv = atlas[0]
    # Not square, in general: one scale for both axes, so that texels stay square on the surface.
    uv = uv * np.array([atlas.width, atlas.height]) / max(atlas.width, atlas.height)
    source = source.astype(np.int64)
    return Surface(surface.vertices[source], faces.astype(np.int64), surface.normals[source], uv.astype(np.float64))


@profiled("keep the object")
def keep_object(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, dict]:
    """The connected component of the largest area; inner shells and floaters go. Faces are turned outward.

    vertices [V,3], faces [F,3]; the report says how much was dropped.
    """
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    labels = trimesh.graph.connected_component_labels(mesh.face_adjacency, node_count=len(faces))
    area = np.bincount(labels, weights=mesh.area_faces)
    # A closed component whose signed volume is opposite to the largest one's is the inner wall of a hollow body.
    corner = vertices[faces]
    volume = np.bincount(labels, weights=np.einsum("ij,ij->i", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])) / 6)
    best = int(area.argmax())
    faces = faces[labels == best]
    if volume[best] < 0:
        faces = faces[:, ::-1]
    used, inverse = np.unique(faces, return_inverse=True)
    others = np.arange(len(area)) != best
    inner = others & (np.sign(volume) != np.sign(volume[best]))
    report = {
        "components": len(area),
        "dropped_inner_shells": int(inner.sum()),
        "dropped_floaters": int((others & ~inner).sum()),
        "dropped_area_fraction": round(float(area[others].sum() / area.sum()), 4),
    }
    return vertices[used], inverse.reshape(-1, 3).astype(np.int64), report


@profiled("marching cubes")
def zero_level(sdf: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Marching cubes over [-1,1]^3 of an SDF [n,n,n] intersected with the unit sphere (which caps what it cuts)."""
    n = sdf.shape[0]
    if not np.isfinite(sdf).all():
        raise LearningError("the object field diverged: its SDF is not finite", "try another --seed or a milder preset")
    axis = np.linspace(-1, 1, n, dtype=np.float32)
    squared = axis * axis
    radius = np.sqrt(squared[:, None, None] + squared[None, :, None] + squared[None, None, :])
    cropped = np.maximum(sdf, radius - _BORDER)
    hint = (
        "check object_center and object_radius in transforms.json (the sphere must just contain the object), "
        "or use masks, or a longer preset"
    )
    if cropped.min() >= 0:
        raise LearningError("no surface was found: the object field is empty inside the sphere", hint)
    if sdf[radius < _BORDER].max() <= 0:
        raise LearningError("no surface was found: the object field fills the whole sphere", hint)
    vertices, faces, _, _ = measure.marching_cubes(cropped, 0.0)
    return vertices.astype(np.float64) * (2 / (n - 1)) - 1, faces.astype(np.int64)


def _above(sdf: np.ndarray, support: Support) -> np.ndarray:
    """The SDF [n,n,n] intersected with the half-space above a support plane."""
    axis = np.linspace(-1, 1, sdf.shape[0], dtype=np.float32)
    x, y, z = (np.float32(c) * axis for c in support.normal)
    below = support.height + MARGIN - (x[:, None, None] + y[None, :, None] + z[None, None, :])
    return np.maximum(sdf, below.astype(np.float32))


@profiled("decimation")
def _decimate(vertices: np.ndarray, faces: np.ndarray, budget: int) -> tuple[np.ndarray, np.ndarray]:
    """At most about `budget` faces, by quadric errors: many where the surface bends, few where it is flat.

    The gentlest pace that meets the budget: a hasty one collapses edges out of order and turns faces by degrees.
    """
    vertices, faces = np.ascontiguousarray(vertices, np.float32), np.ascontiguousarray(faces, np.int32)
    for aggressiveness in (2, 3, 5, 7):
        simple, simple_faces = fast_simplification.simplify(vertices, faces, target_count=budget, agg=aggressiveness)
        if len(simple_faces) <= 1.02 * budget:
            break
    return simple.astype(np.float64), simple_faces.astype(np.int64)


def _weld(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Coincident vertices become one; degenerate and duplicate faces go."""
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    mesh.update_faces(mesh.nondegenerate_faces(height=1e-9) & mesh.unique_faces())
    mesh.remove_unreferenced_vertices()
    return np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64)


def _area_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Area-weighted vertex normals, shared by vertices at the same place (so that UV seams do not show)."""
    _, place = np.unique(np.round(vertices / max(np.abs(vertices).max(), 1e-20) * 1e7), axis=0, return_inverse=True)
    place = place.ravel()
    corner = vertices[faces]
    face_normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    total = np.zeros((place.max() + 1, 3))
    for k in range(3):
        np.add.at(total, place[faces[:, k]], face_normal)
    return _unit(total)[place]


def _field_normals(object_field: ObjectField, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """The SDF's gradient at the vertices; the mesh's own normal where the two disagree (caps, thin folds)."""
    device = next(object_field.parameters()).device
    field = object_field.normal(torch.as_tensor(vertices, dtype=torch.float32, device=device)).double().cpu().numpy()
    mesh = _area_normals(vertices, faces)
    agree = np.isfinite(field).all(1) & (np.einsum("ij,ij->i", np.nan_to_num(field), mesh) > 0.5)
    return _unit(np.where(agree[:, None], field, mesh))


def _unit(vectors: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.where(length > 1e-30, vectors / np.maximum(length, 1e-30), np.array([0.0, 0.0, 1.0]))
