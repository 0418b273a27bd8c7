"""Bakes textures over the unwrapped surface from the materials at labeled points."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from scipy.spatial import cKDTree

from blender_nep.geometry.mesh import Surface
from blender_nep.geometry.uv_raster import nearest_known, rasterize
from blender_nep.materials.shown_faces import ShownParts
from blender_nep.profiling import profiled
from blender_nep.shading.plenoptic import SurfacePoints

NEIGHBORS = 16
"""Number of nearest points that decide the material of a point."""
_NEAREST = 4
"""Samples among which the nearest one on the same side is looked for"""
_ENOUGH = 4
"""Neighbors on the same side of a thin wall that are enough to tell its paint"""
_BLOCK = 1 << 16
"""Texels that are baked at a time. This bounds the memory (16 neighbors each), whatever the texture's size."""


@dataclass
class LabeledPoints:
    """n points of the surface whose materials are known."""

    position: np.ndarray
    """[n, 3] unit frame"""
    normal: np.ndarray
    """[n, 3] unit vectors"""
    photo: np.ndarray
    """[n] int, index of the photo that shows the point"""
    albedo: np.ndarray
    """[n, 3] linear"""
    roughness: np.ndarray
    """[n] Principled's roughness"""
    metallic: np.ndarray
    """[n] Principled's metallic"""
    residual: np.ndarray
    """[n] residual of the point's material"""


@profiled("neighbors")
def neighbors(tree: cKDTree, points: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Distances and indices [n, count] of the samples in `tree` that are nearest to each point [n, 3].

    If the tree has fewer than `count` samples, all of them are returned.
    """
    count = min(count, tree.n)
    distance, index = tree.query(points, k=count, workers=torch.get_num_threads())
    return distance.reshape(len(points), count), index.reshape(len(points), count)


class Places(NamedTuple):
    """n places of the surface."""

    position: np.ndarray
    """[n, 3] unit frame"""
    normal: np.ndarray
    """[n, 3] unit vectors"""


def on_same_side(
    found: tuple[np.ndarray, np.ndarray], points: Places, samples: Places, enough: int = _ENOUGH
) -> tuple[np.ndarray, np.ndarray]:
    """What `neighbors` has `found` for m points among n samples, without what lies on the other side of a thin wall.

    The other side may have another paint. A neighbor that lies behind a point, and whose normal is turned away from the
    point's by more than 90 degrees, gets an infinite distance, and the index of the nearest one that is not so. The other
    side of a groove lies before a point, and stays. Where fewer than `enough` neighbors would be left, as in a hollow that
    hardly any photo shows, all stay: both sides of a wall mostly have one paint.
    """
    distance, index = found
    other = np.empty(index.shape, bool)
    for k, column in enumerate(index.T):
        turned = np.einsum("mk,mk->m", points.normal, samples.normal[column]) < 0
        other[:, k] = turned & (np.einsum("mk,mk->m", points.normal, samples.position[column] - points.position) < 0)
    other[(~other).sum(1) < min(enough, other.shape[1])] = False
    if not other.any():
        return distance, index
    nearest = np.take_along_axis(index, (~other).argmax(1)[:, None], 1)
    return np.where(other, np.inf, distance), np.where(other, nearest, index)


def weighted_mean(cost: np.ndarray, distance: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Mean cost [m, K] over the neighbors of m points, weighted by `kernel`.

    distance, index [m, count]: of the neighbors; `index` points into cost [n, K].
    """
    weight = kernel(distance)
    return np.stack([(c[index] * weight).sum(1) for c in cost.T], 1) / weight.sum(1, keepdims=True)


def kernel(distance: np.ndarray) -> np.ndarray:
    """Weights [m, count] of neighbors at distances [m, count]: a tenth at the farthest one, and 0 at an infinite distance.

    Where all distances are infinite, the weights are 1.
    """
    reach = np.maximum(np.where(np.isfinite(distance), distance, 0.0).max(1, keepdims=True), 1e-9)
    weight = np.exp(-2.3 * (distance / reach) ** 2)
    return np.where(np.isfinite(distance).any(1, keepdims=True), weight, 1.0)


def texture_size(surface: Surface, footprint: float, most: int) -> int:
    """Side of the textures in texels: the power of two that makes a texel about as wide as `footprint` on the surface.

    `footprint` is the width of a pixel on the surface in the unit frame. The result is at least 256 and at most `most`.
    """
    corner = surface.vertices[surface.faces]
    area = 0.5 * np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1).sum()
    flat = surface.atlas[surface.faces]
    side, up = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    used = 0.5 * np.abs(side[:, 0] * up[:, 1] - side[:, 1] * up[:, 0]).sum()
    wanted = math.sqrt(area / max(used, 1e-3)) / max(footprint, 1e-6)
    return int(np.clip(2 ** round(math.log2(max(wanted, 1))), min(256, most), most))


@profiled("textures")
def bake(
    surface: Surface, labeled: LabeledPoints, size: int, shown: ShownParts | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Textures with S = `size` texels a side: albedo [S, S, 3], roughness, metallic and confidence [S, S], float32.

    A texel takes the weighted mean of the materials of the nearest labeled points. A texel outside the UV charts takes the
    value of the nearest texel inside. Confidence is in 0..1. It is higher if more photos show the neighbors, if they are
    nearer, and if their materials explain them better. It is 0 where no photo shows the surface. `shown` says where photos
    show it; None: everywhere.
    """
    face, barycentric = rasterize(surface.atlas, surface.faces, size)
    known = face >= 0
    face, barycentric = face[known], barycentric[known]
    # Without compact nodes, texels on faces that no photo shows, far from all points, find their neighbors twice as fast.
    tree, count = cKDTree(labeled.position, leafsize=32, compact_nodes=False), len(face)
    values = np.concatenate([labeled.albedo, labeled.roughness[:, None], labeled.metallic[:, None]], 1)
    material, residual = np.empty((count, 5), np.float32), np.empty(count, np.float32)
    photos, nearest, farthest = np.empty(count, np.int64), np.empty(count), np.empty(count)
    for start in range(0, count, _BLOCK):
        part = slice(start, start + _BLOCK)
        corner = surface.faces[face[part]]
        both = (surface.vertices, surface.normals)
        points, normal = (np.einsum("nc,nck->nk", barycentric[part], of_vertices[corner]) for of_vertices in both)
        found = neighbors(tree, points, NEIGHBORS)
        distance, index = on_same_side(found, Places(points, normal), Places(labeled.position, labeled.normal))
        material[part] = weighted_mean(values, distance, index)
        residual[part] = weighted_mean(labeled.residual[:, None], distance, index)[:, 0]
        photos[part] = 1 + (np.diff(np.sort(labeled.photo[index], 1), axis=1) > 0).sum(1)
        nearest[part], farthest[part] = distance.min(1), np.where(np.isfinite(distance), distance, 0.0).max(1)
    spacing = np.median(farthest) if count else 1.0
    seen = (1 - np.exp(-photos / 4)) * np.exp(-np.maximum(nearest / spacing - 1, 0))
    confidence = seen * np.exp(-residual / 0.1)
    if shown is not None:
        confidence *= shown.at(face, barycentric)
    fill = nearest_known(known)

    def texture(values: np.ndarray) -> np.ndarray:
        out = np.zeros((*known.shape, *values.shape[1:]), np.float32)
        out[known] = values
        return out[fill]

    material = material.clip(0, 1)
    return texture(material[:, :3]), texture(material[:, 3]), texture(material[:, 4]), texture(confidence)


@profiled("labels")
def labels_at(tree: cKDTree, samples: Places, labels: torch.Tensor, points: SurfacePoints) -> torch.Tensor:
    """The label [m] of the sample that is nearest to each of m points, and on the same side of a thin wall.

    `tree` holds the positions of the n samples, labels [n] are theirs.
    """
    asked = Places(points.position.cpu().numpy(), points.normal.cpu().numpy())
    _, index = on_same_side(neighbors(tree, asked.position, _NEAREST), asked, samples, enough=1)
    return labels[torch.from_numpy(index[:, 0].astype(np.int64)).to(labels.device)]
