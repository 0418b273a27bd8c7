"""From materials at photo samples to textures over the unwrapped surface."""

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
"""Samples that vote on the material of a point."""
_BLOCK = 1 << 16
"""Texels at once: bounds the memory (16 neighbours each), whatever the texture's size."""


@dataclass
class LabelledPoints:
    """Points of the surface whose materials are known, all [n, ...]: where, from which photo, how well each palette
    material fits."""

    position: np.ndarray
    photo: np.ndarray
    cost: np.ndarray
    """[n,K] clipped residual of each material"""
    albedo: np.ndarray
    """[n,3] the palette's albedo, or a local one where the photos demand it"""
    residual: np.ndarray
    """[n] of the chosen material"""


@profiled("neighbours")
def neighbours(tree: cKDTree, points: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Distances and indices [n,count] of the nearest samples."""
    count = min(count, tree.n)
    distance, index = tree.query(points, k=count, workers=-1)
    return distance.reshape(len(points), count), index.reshape(len(points), count)


def vote(cost: np.ndarray, distance: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Material [m] int with the least cost over each point's neighbours, near ones counting more. cost [n,K]."""
    return weighted_mean(cost, distance, index).argmin(1)


def weighted_mean(cost: np.ndarray, distance: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Mean cost [m,K] over each point's neighbours, near ones counting more. distance, index [m,count] into cost [n,K]."""
    weight = kernel(distance)
    return np.stack([(c[index] * weight).sum(1) for c in cost.T], 1) / weight.sum(1, keepdims=True)


def kernel(distance: np.ndarray) -> np.ndarray:
    """Weights [m,count] that fall to a tenth at the farthest neighbour."""
    reach = np.maximum(distance[:, -1:], 1e-9)
    return np.exp(-2.3 * (distance / reach) ** 2)


def texture_size(surface: Surface, footprint: float, most: int) -> int:
    """Side in texels, a power of two: a texel as large as a pixel's footprint on the surface [unit frame]."""
    corner = surface.vertices[surface.faces]
    area = 0.5 * np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1).sum()
    flat = surface.atlas[surface.faces]
    side, up = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    used = 0.5 * np.abs(side[:, 0] * up[:, 1] - side[:, 1] * up[:, 0]).sum()
    wanted = math.sqrt(area / max(used, 1e-3)) / max(footprint, 1e-6)
    return int(np.clip(2 ** round(math.log2(max(wanted, 1))), min(256, most), most))


@profiled("textures")
def bake(
    surface: Surface, labelled: LabelledPoints, palette: Palette, size: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Albedo [S,S,3], roughness, metallic, confidence [S,S] float32, seams dilated.

    A texel takes the material that the samples around it vote for; one that no photo saw takes that of the nearest.
    Confidence is 0..1: how many photos saw it, how near, how well the material explains them.
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
    """What the samples around texels say, all [n, ...]."""

    label: np.ndarray
    """of the material with the least cost"""
    local_albedo: np.ndarray
    """[n,3] mean over the neighbours that carry that material"""
    support: np.ndarray
    """their weight; 0 where none does"""
    residual: np.ndarray
    photos: np.ndarray
    """how many the neighbours are from"""
    nearest: np.ndarray
    farthest: np.ndarray
    """distances of the neighbours"""

    @classmethod
    def of(cls, points: np.ndarray, labelled: LabelledPoints, sample_label: np.ndarray, tree: cKDTree) -> _TexelVotes:
        """For points [n,3]; sample_label [m] is each sample's material."""
        distance, index = neighbours(tree, points, NEIGHBOURS)
        label, weight = vote(labelled.cost, distance, index), kernel(distance)
        own = weight * (sample_label[index] == label[:, None])
        support = own.sum(1)
        albedo = np.einsum("nk,nkc->nc", own, labelled.albedo[index]) / np.maximum(support, 1e-9)[:, None]
        photos = 1 + (np.diff(np.sort(labelled.photo[index], 1), axis=1) > 0).sum(1)
        residual = (labelled.residual[index] * weight).sum(1) / weight.sum(1)
        nearest, farthest = distance[:, 0].copy(), distance[:, -1].copy()  # not views, which would keep all distances
        return cls(label, albedo.astype(np.float32), support, residual, photos, nearest, farthest)

    @classmethod
    def joined(cls, parts: list[_TexelVotes]) -> _TexelVotes:
        """One after the other."""
        return cls(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(cls)))


@profiled("labels")
def labels_at(tree: cKDTree, labels: torch.Tensor, points: torch.Tensor) -> torch.Tensor:
    """The label [m] of the sample nearest to each point [m,3]."""
    nearest = tree.query(points.cpu().numpy(), workers=-1)[1]
    return labels[torch.from_numpy(np.asarray(nearest, np.int64)).to(labels.device)]
