"""Which pixels of the photos the materials are learned from, and what each of them shows of the surface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from blender_nep.capture.pixel_rays import BRIGHTEST_CLIPPED, SATURATED, pixel_width
from blender_nep.errors import LearningError
from blender_nep.geometry.ray_tracing import RayTracer
from blender_nep.profiling import profiled

if TYPE_CHECKING:
    from blender_nep.capture.pixel_rays import PixelRays

_CANDIDATES_PER_SAMPLE = 12
_VOXEL = 0.05
"""Width of the voxels over which samples are spread, unit frame."""
_EDGE_PIXELS = 2.0
"""A pixel counts as an edge when the surface is not continuous this far around it."""


@dataclass
class PhotoSamples:
    """Pixels that show the surface: where, from where, and how bright."""

    face: np.ndarray
    """[n] int"""
    barycentric: np.ndarray
    """[n,3]"""
    position: np.ndarray
    """[n,3]"""
    view: Tensor
    """[n,3] unit, towards the camera"""
    photo: Tensor
    """[n] which photo"""
    radiance: Tensor
    """[n,3] linear"""
    skipped: dict
    """Shares of the pixels tried that were left out, by reason"""

    def __len__(self) -> int:
        return len(self.face)


@profiled("select samples")
def select_samples(
    rays: PixelRays,
    tracer: RayTracer,
    normals: np.ndarray,
    *,
    count: int,
    least_cosine: float,
    generator: np.random.Generator,
    candidates: int = _CANDIDATES_PER_SAMPLE,
) -> PhotoSamples:
    """At most `count` pixels spread over the surface and the views, with what carries no information left out; for each,
    `candidates` are looked at.

    Raises LearningError when no pixel shows the mesh.
    """
    sphere = rays.sphere
    tried = min(len(sphere), count * candidates)
    pick = np.sort(generator.choice(len(sphere), tried, replace=False))
    index = sphere[torch.from_numpy(pick).to(sphere.device)]
    o, d, angle = (x.cpu().numpy() for x in rays.rays(index))
    t, face, barycentric = tracer.intersect(o, d)
    on = np.isfinite(t)
    skipped = {}
    total = max(int(on.sum()), 1)

    def leave_out(reason: str, bad: np.ndarray) -> None:
        nonlocal on
        skipped[reason] = round(float((on & bad).sum() / total), 4)
        on = on & ~bad

    if rays.mask is not None:
        leave_out("masked_out", rays.mask[index].cpu().numpy() < 250)
    smooth = tracer.smooth_normals(normals, np.maximum(face, 0), barycentric)
    cosine = -np.einsum("ij,ij->i", tracer.face_normals[np.maximum(face, 0)], d)
    cosine = np.minimum(np.abs(cosine), -np.einsum("ij,ij->i", smooth, d) * np.sign(cosine))
    leave_out("grazing", cosine < least_cosine)
    leave_out("edge", on & _edges(tracer, o, d, t, angle, cosine, on))
    if rays.brightest <= BRIGHTEST_CLIPPED:
        leave_out("saturated", (rays.radiance[index].amax(-1) > SATURATED).cpu().numpy())
    chosen = np.flatnonzero(on)
    if len(chosen) == 0:
        raise LearningError(
            "no photo shows the surface well enough to learn its material",
            "the surface may be wrong: look at mesh.obj, and check the object's bounding sphere",
        )
    position = o[chosen] + d[chosen] * t[chosen, None]
    if len(chosen) > count:
        keep = _spread(position, count, generator)
        chosen, position = chosen[keep], position[keep]
    device = sphere.device
    at = torch.from_numpy(chosen).to(device)
    return PhotoSamples(
        face[chosen],
        barycentric[chosen],
        position.astype(np.float32),
        -torch.from_numpy(d[chosen]).to(device),
        rays.view_of(index[at]),
        rays.photo(index[at]),
        skipped,
    )


def _edges(
    tracer: RayTracer, o: np.ndarray, d: np.ndarray, t: np.ndarray, angle: np.ndarray, cosine: np.ndarray, on: np.ndarray
) -> np.ndarray:
    """Whether the surface around a pixel [n] bool is cut off: a neighbouring ray misses, or is far off its plane."""
    rows = np.flatnonzero(on)
    out = np.zeros(len(o), bool)
    side = np.cross(d[rows], np.where(np.abs(d[rows, 2:]) < 0.9, [[0, 0, 1.0]], [[1.0, 0, 0]]))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    up = np.cross(side, d[rows])
    reach = _EDGE_PIXELS * pixel_width(angle[rows, None])
    for step in (side, -side, up, -up):
        neighbour = d[rows] + reach * step
        neighbour /= np.linalg.norm(neighbour, axis=1, keepdims=True)
        near = tracer.intersect(o[rows], neighbour)[0]
        allowed = 4 * reach[:, 0] * t[rows] / np.maximum(cosine[rows], 0.05)
        out[rows] |= ~(np.abs(near - t[rows]) < allowed)
    return out


def _spread(position: np.ndarray, count: int, generator: np.random.Generator) -> np.ndarray:
    """Indices of `count` points, those in crowded voxels kept with a lower chance (inverse square root)."""
    voxel = np.floor(position / _VOXEL).astype(np.int64)
    _, inverse, crowd = np.unique(voxel, axis=0, return_inverse=True, return_counts=True)
    weight = 1 / np.sqrt(crowd[inverse.ravel()])
    key = generator.exponential(size=len(position)) / weight
    return np.sort(np.argpartition(key, count - 1)[:count])
