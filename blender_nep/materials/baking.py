"""Bakes textures over the unwrapped surface from the materials at labelled points."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
import torch
from scipy.spatial import cKDTree

from blender_nep.geometry.mesh import Surface
from blender_nep.geometry.uv_raster import nearest_known, rasterise
from blender_nep.materials.palette import Palette
from blender_nep.profiling import profiled

NEIGHBOURS = 16
"""Number of nearest samples that vote on the material of a point."""
_BLOCK = 1 << 16
"""Texels that are baked at a time. This bounds the memory (16 neighbours each), whatever the texture's size."""


@dataclass
class LabelledPoints:
    """n points of the surface whose materials are known, and how well each of the palette's K materials fits them."""

    position: np.ndarray
    """[n, 3] unit frame"""
    photo: np.ndarray
    """[n] int, index of the photo that shows the point"""
    cost: np.ndarray
    """[n, K] clipped residual of each material, averaged over the point's neighbours"""
    albedo: np.ndarray
    """[n, 3] albedo of the point's material, linear"""
    residual: np.ndarray
    """[n] residual of the point's material"""


@profiled("neighbours")
def neighbours(tree: cKDTree, points: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Distances and indices [n, count] of the samples in `tree` that are nearest to each point [n, 3].

    If the tree has fewer than `count` samples, all of them are returned.
    """
    count = min(count, tree.n)
    distance, index = tree.query(points, k=count, workers=-1)
    return distance.reshape(len(points), count), index.reshape(len(points), count)


def vote(cost: np.ndarray, distance: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Index [m] int of the material with the least mean cost over each point's neighbours (`weighted_mean`)."""
    return weighted_mean(cost, distance, index).argmin(1)


def weighted_mean(cost: np.ndarray, distance: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Mean cost [m, K] over the neighbours of m points, weighted by `kernel`.

    distance, index [m, count]: of the neighbours; `index` points into cost [n, K].
    """
    weight = kernel(distance)
    return np.stack([(c[index] * weight).sum(1) for c in cost.T], 1) / weight.sum(1, keepdims=True)


def kernel(distance: np.ndarray) -> np.ndarray:
    """Weights [m, count] of neighbours at distances [m, count], sorted by distance: a tenth at the farthest one."""
    reach = np.maximum(distance[:, -1:], 1e-9)
    return np.exp(-2.3 * (distance / reach) ** 2)


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
    surface: Surface, labelled: LabelledPoints, palette: Palette, size: int, shown: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Textures with S = `size` texels a side: albedo [S, S, 3], roughness, metallic and confidence [S, S], float32.

    A texel takes the material for which the labelled points around it vote; a texel that no photo shows takes the material
    of the nearest points. A texel outside the UV charts takes the value of the nearest texel inside. Confidence is in 0..1.
    It is higher if more photos show the neighbours, if they are nearer, and if the material explains them better. It is 0
    on faces that no photo shows: shown [F] says which do; without it, all do.
    """
    face, barycentric = rasterise(surface.atlas, surface.faces, size)
    known = face >= 0
    face, barycentric = face[known], barycentric[known]
    tree, sample_label = cKDTree(labelled.position), labelled.cost.argmin(1)
    blocks = []
    for start in range(0, max(len(face), 1), _BLOCK):
        part = slice(start, start + _BLOCK)
        points = np.einsum("nc,nck->nk", barycentric[part], surface.vertices[surface.faces[face[part]]])
        blocks.append(_TexelVotes.of(points, labelled, sample_label, tree))
    votes = _TexelVotes.joined(blocks)
    del blocks, barycentric
    albedo = np.where(votes.support[:, None] > 1e-3, votes.local_albedo, palette.albedo.cpu().numpy()[votes.label])
    spacing = np.median(votes.farthest)
    seen = (1 - np.exp(-votes.photos / 4)) * np.exp(-np.maximum(votes.nearest / spacing - 1, 0))
    confidence = seen * np.exp(-votes.residual / 0.1)
    if shown is not None:
        confidence *= shown[face]
    fill = nearest_known(known)

    def texture(values: np.ndarray) -> np.ndarray:
        out = np.zeros((*known.shape, *values.shape[1:]), np.float32)
        out[known] = values
        return out[fill]

    return (
        texture(albedo.clip(0, 1)),
        texture(palette.roughness.cpu().numpy()[votes.label]),
        texture(palette.metallic.cpu().numpy()[votes.label]),
        texture(confidence),
    )


@dataclass
class _TexelVotes:
    """The votes of the labelled points around n texels; all arrays are [n, ...]."""

    label: np.ndarray
    """[n] index of the material with the least cost"""
    local_albedo: np.ndarray
    """[n, 3] mean albedo of the neighbours that have that material"""
    support: np.ndarray
    """[n] sum of the weights of those neighbours; 0 if there are none"""
    residual: np.ndarray
    """[n] weighted mean residual of all neighbours"""
    photos: np.ndarray
    """[n] number of photos that the neighbours come from"""
    nearest: np.ndarray
    """[n] distance of the nearest neighbour"""
    farthest: np.ndarray
    """[n] distance of the farthest neighbour"""

    @classmethod
    def of(cls, points: np.ndarray, labelled: LabelledPoints, sample_label: np.ndarray, tree: cKDTree) -> _TexelVotes:
        """The votes for points [n, 3]; sample_label [m] is the material of each labelled point."""
        distance, index = neighbours(tree, points, NEIGHBOURS)
        label, weight = vote(labelled.cost, distance, index), kernel(distance)
        own = weight * (sample_label[index] == label[:, None])
        support = own.sum(1)
        albedo = np.einsum("nk,nkc->nc", own, labelled.albedo[index]) / np.maximum(support, 1e-9)[:, None]
        photos = 1 + (np.diff(np.sort(labelled.photo[index], 1), axis=1) > 0).sum(1)
        residual = (labelled.residual[index] * weight).sum(1) / weight.sum(1)
        nearest, farthest = distance[:, 0].copy(), distance[:, -1].copy()  # views would keep all distances in memory
        return cls(label, albedo.astype(np.float32), support, residual, photos, nearest, farthest)

    @classmethod
    def joined(cls, parts: list[_TexelVotes]) -> _TexelVotes:
        """The votes of all parts, one part after the other."""
        return cls(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(cls)))


@profiled("labels")
def labels_at(tree: cKDTree, labels: torch.Tensor, points: torch.Tensor) -> torch.Tensor:
    """The label [m] of the sample in `tree` that is nearest to each point [m, 3]; labels [n] are those of the samples."""
    nearest = tree.query(points.cpu().numpy(), workers=-1)[1]
    return labels[torch.from_numpy(np.asarray(nearest, np.int64)).to(labels.device)]
