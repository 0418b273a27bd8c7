"""Selects the pixels of the photos from which materials are learned, and finds the surface point that each of them shows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from blender_nep.capture.rays.pixel_rays import BRIGHTEST_CLIPPED
from blender_nep.capture.rays.pixel_width import pixel_width
from blender_nep.errors import LearningError
from blender_nep.geometry.ray_tracing import RayTracer
from blender_nep.profiling import profiled

if TYPE_CHECKING:
    from blender_nep.capture.rays.pixel_rays import PixelRays

_CANDIDATES_PER_SAMPLE = 12
_VOXEL = 0.05
"""Width of the voxels over which samples are spread, in the unit frame."""
_EDGE_PIXELS = 2.0
"""A pixel counts as an edge if the surface is not continuous within this many pixels around it. The neighbors that tell the
variance of the reflection are as far away."""
_MOST_UNEVEN = 1.5
"""The change of the mirrored direction counts up to so many times the change to the neighbor with the smaller change."""


@dataclass
class PhotoSamples:
    """n pixels that show the surface: the surface points that they show, the directions to the camera, and the radiance."""

    face: np.ndarray
    """[n] int, index of the face"""
    barycentric: np.ndarray
    """[n, 3] coordinates in the face"""
    position: np.ndarray
    """[n, 3] unit frame"""
    view: Tensor
    """[n, 3] unit vectors towards the camera"""
    photo: Tensor
    """[n] int64, index of the photo"""
    radiance: Tensor
    """[n, 3] linear, as if all photos had one exposure"""
    reflection_variance: Tensor
    """[n] radians^2, variance of the mirrored direction within the pixel: the mean over two perpendicular axes"""
    skipped: dict
    """{reason: share of the tried pixels that were left out for it}; pixels that miss the mesh are not counted"""

    def __len__(self) -> int:
        return len(self.face)

    @classmethod
    def joined(cls, first: PhotoSamples, second: PhotoSamples) -> PhotoSamples:
        """The samples of both. `skipped` is that of the first."""
        return cls(
            np.concatenate([first.face, second.face]),
            np.concatenate([first.barycentric, second.barycentric]),
            np.concatenate([first.position, second.position]),
            torch.cat([first.view, second.view]),
            torch.cat([first.photo, second.photo]),
            torch.cat([first.radiance, second.radiance]),
            torch.cat([first.reflection_variance, second.reflection_variance]),
            first.skipped,
        )


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
    """Select at most `count` pixels, spread over the surface. For each, `candidates` random pixels are tried.

    Left out are pixels outside the mask, at grazing angles, at edges of the surface, and clipped ones. Raises LearningError
    when no pixel is left.
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
    edge, variance = edges_and_reflection_variance(tracer, normals, o, d, t, angle, smooth, cosine, on)
    leave_out("edge", on & edge)
    if rays.brightest <= BRIGHTEST_CLIPPED:
        leave_out("saturated", rays.burnt_out(index).cpu().numpy())
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
        torch.from_numpy(variance[chosen]).float().to(device),
        skipped,
    )


def edges_and_reflection_variance(
    tracer: RayTracer,
    normals: np.ndarray,
    o: np.ndarray,
    d: np.ndarray,
    t: np.ndarray,
    angle: np.ndarray,
    smooth: np.ndarray,
    cosine: np.ndarray,
    on: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """What the neighbors of the pixels [n] show: whether there is an edge [n] bool, and the reflection's variance [n].

    There is an edge if the surface is not continuous around the pixel. That is so where a neighboring ray misses the mesh,
    or meets it far from the plane of the pixel's surface point.

    The variance is in radians^2. The mirrored direction is taken to change evenly over a square pixel. Then its variance is
    (change across the pixel)^2 / 12 along an axis of the pixel. The covariance of a square is the same along all axes, so
    any two perpendicular axes serve; the result is half the sum over both. The change is that between the two neighbors
    along the axis (ray differentials: Igehy 1999). Where a neighbor lies beyond a crease, the other one limits it.
    """
    rows = np.flatnonzero(on)
    edge, variance = np.zeros(len(o), bool), np.zeros(len(o))
    reach = _EDGE_PIXELS * pixel_width(angle[rows, None])
    own = _mirrored(d[rows], smooth[rows])
    for opposite in _neighbors(d[rows], reach):
        mirrored = []
        for neighbor in opposite:
            near, face, barycentric = tracer.intersect(o[rows], neighbor)
            allowed = 4 * reach[:, 0] * t[rows] / np.maximum(cosine[rows], 0.05)
            edge[rows] |= ~(np.abs(near - t[rows]) < allowed)
            mirrored.append(_mirrored(neighbor, tracer.smooth_normals(normals, np.maximum(face, 0), barycentric)))
        to_each = [np.linalg.norm(there - own, axis=1) for there in mirrored]
        between = np.linalg.norm(mirrored[0] - mirrored[1], axis=1)
        change = np.minimum(between / 2, _MOST_UNEVEN * np.minimum(*to_each)) / _EDGE_PIXELS
        variance[rows] += change**2 / 24
    return edge, variance


def beside_surface(tracer: RayTracer, o: np.ndarray, d: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """Which pixels [n] bool that miss the mesh are at its edge: one of their neighbors meets it.

    o, d [n, 3] are the origins and unit directions of their rays, angle [n] their half-angles in radians.
    """
    beside = np.zeros(len(o), bool)
    for opposite in _neighbors(d, _EDGE_PIXELS * pixel_width(angle[:, None])):
        for neighbor in opposite:
            beside |= np.isfinite(tracer.intersect(o, neighbor)[0])
    return beside


def _neighbors(d: np.ndarray, reach: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """The directions of two opposite neighbors [n, 3] along each of two axes of the pixels with directions d [n, 3].

    reach [n, 1] is the tangent of the angle to them.
    """
    side = np.cross(d, np.where(np.abs(d[:, 2:]) < 0.9, [[0, 0, 1.0]], [[1.0, 0, 0]]))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    return [(_normalized(d + reach * along), _normalized(d - reach * along)) for along in (side, np.cross(side, d))]


def _normalized(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def _mirrored(direction: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """The directions [n, 3] of rays that a mirror with normals [n, 3] sends on."""
    return direction - 2 * (direction * normal).sum(1, keepdims=True) * normal


def _spread(position: np.ndarray, count: int, generator: np.random.Generator) -> np.ndarray:
    """Indices of `count` random points. A point's weight is 1 / sqrt(number of points in its voxel)."""
    voxel = np.floor(position / _VOXEL).astype(np.int64)
    _, inverse, crowd = np.unique(voxel, axis=0, return_inverse=True, return_counts=True)
    weight = 1 / np.sqrt(crowd[inverse.ravel()])
    key = generator.exponential(size=len(position)) / weight
    return np.sort(np.argpartition(key, count - 1)[:count])
