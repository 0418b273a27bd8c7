"""From materials at photo samples to textures over the unwrapped surface."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from scipy.spatial import cKDTree

from blender_nep.material_palette import Palette
from blender_nep.profile import profiled
from blender_nep.surface import Surface
from blender_nep.texels import dilate, rasterise

NEIGHBOURS = 16
"""Samples that vote on the material of a point."""


@dataclass
class Evidence:
    """What the samples say, all [n, ...]: where, from which photo, how well each palette material fits."""

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
    flat = surface.uv[surface.faces]
    side, up = flat[:, 1] - flat[:, 0], flat[:, 2] - flat[:, 0]
    used = 0.5 * np.abs(side[:, 0] * up[:, 1] - side[:, 1] * up[:, 0]).sum()
    wanted = math.sqrt(area / max(used, 1e-3)) / max(footprint, 1e-6)
    return int(np.clip(2 ** round(math.log2(max(wanted, 1))), min(256, most), most))


@profiled("textures")
def bake(surface: Surface, evidence: Evidence, palette: Palette, size: int
         ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Albedo [S,S,3], roughness, metallic, confidence [S,S] float32, seams dilated.

    A texel takes the material that the samples around it vote for; one that no photo saw takes that of the nearest.
    Confidence is 0..1: how many photos saw it, how near, how well the material explains them.
    """
    face, barycentric = rasterise(surface.uv, surface.faces, size)
    known = face >= 0
    points = np.einsum("nc,nck->nk", barycentric[known], surface.vertices[surface.faces[face[known]]])
    tree = cKDTree(evidence.position)
    distance, index = neighbours(tree, points, NEIGHBOURS)
    label = vote(evidence.cost, distance, index)
    weight = kernel(distance)
    # Local albedos of the neighbours that carry the chosen material; the palette's own where none does.
    own = weight * (evidence.cost.argmin(1)[index] == label[:, None])
    total = own.sum(1, keepdims=True)
    local = np.einsum("nk,nkc->nc", own, evidence.albedo[index]) / np.maximum(total, 1e-9)
    albedo = np.where(total > 1e-3, local, palette.albedo.cpu().numpy()[label])

    spacing = np.median(distance[:, -1])
    photos = np.sort(evidence.photo[index], 1)
    several = 1 + (np.diff(photos, axis=1) > 0).sum(1)
    seen = (1 - np.exp(-several / 4)) * np.exp(-np.maximum(distance[:, 0] / spacing - 1, 0))
    residual = (evidence.residual[index] * weight).sum(1) / weight.sum(1)
    confidence = seen * np.exp(-residual / 0.1)

    def texture(values: np.ndarray) -> np.ndarray:
        out = np.zeros((*face.shape, *values.shape[1:]), np.float32)
        out[known] = values
        return dilate(out, known)

    return (texture(albedo.clip(0, 1)), texture(palette.roughness.cpu().numpy()[label]),
            texture(palette.metallic.cpu().numpy()[label]), texture(confidence))


@profiled("labels")
def labels_at(tree: cKDTree, labels: torch.Tensor, points: torch.Tensor) -> torch.Tensor:
    """The label [m] of the sample nearest to each point [m,3]."""
    nearest = tree.query(points.cpu().numpy(), workers=-1)[1]
    return labels[torch.from_numpy(np.asarray(nearest, np.int64)).to(labels.device)]
