"""The SDF of an object in the cells of the cube around its sphere."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy import ndimage
from skimage.measure import marching_cubes
from torch import Tensor
from torch.nn import functional

from blender_nep.geometry.ray_tracing import RayTracer

_TRACED_CELLS = 64
"""A surface is traced as a mesh from at most so many cells along a side."""
_NOWHERE = 1.0
"""The SDF where there is no object at all, in radii of the object's sphere."""


@dataclass(frozen=True)
class SurfaceCells:
    """The k cells inside an object that touch its surface."""

    mask: np.ndarray
    """[n, n, n] bool"""
    place: np.ndarray
    """[k, 3] int: the cells, in the order of `mask`"""
    points: np.ndarray
    """[k, 3] float32: a point of the surface near each cell's center, in the unit frame"""
    normals: np.ndarray
    """[k, 3] float32 unit vectors, outwards"""


@dataclass(frozen=True)
class SdfGrid:
    """The values of an SDF at the centers of n^3 cells of [-1, 1]^3."""

    values: np.ndarray
    """[n, n, n] negative inside, in radii of the object's sphere; the axes are x, y, z"""

    @classmethod
    def of_solid(cls, solid: np.ndarray) -> SdfGrid:
        """The signed distances from the border of the solid cells [n, n, n] bool. Where no cell is solid, all are 1."""
        return cls(signed_distances(solid, 2 / len(solid)))

    @property
    def cell(self) -> float:
        """The width of a cell."""
        return 2 / len(self.values)

    @property
    def solid(self) -> np.ndarray:
        """[n, n, n] bool: the cells whose centers are inside."""
        return self.values < 0

    def centers(self) -> np.ndarray:
        """The centers [n, n, n, 3] of all cells."""
        axis = cell_centers(len(self.values))
        return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1)

    def centers_of(self, mask: np.ndarray) -> np.ndarray:
        """The centers [k, 3] of the cells mask [n, n, n] bool."""
        axis = cell_centers(len(self.values))
        return np.stack([axis[index] for index in np.nonzero(mask)], -1)

    def sample(self, points: Tensor) -> Tensor:
        """The SDF [...] at points [..., 3], interpolated; outside the cube, that of its border."""
        return sampled(torch.from_numpy(self.values).to(points), points)

    def normals(self, place: np.ndarray) -> np.ndarray:
        """Unit normals [k, 3] float32, outwards, at the centers of cells place [k, 3] int."""
        gradient = np.stack([part[tuple(place.T)] for part in np.gradient(self.values)], -1)
        return (gradient / np.linalg.norm(gradient, axis=-1, keepdims=True).clip(1e-9)).astype(np.float32)

    def surface(self) -> SurfaceCells:
        """The cells inside the object that touch its surface."""
        mask = self.solid & ndimage.binary_dilation(~self.solid)
        place = np.stack(np.nonzero(mask), -1)
        normals = self.normals(place)
        points = (self.centers_of(mask) - normals * self.values[mask][:, None]).astype(np.float32)
        return SurfaceCells(mask, place, points, normals)

    def traced_mesh(self) -> RayTracer | None:
        """The surface as a mesh of cells not finer than 1/64 of the cube; None if nothing is inside."""
        cells = min(_TRACED_CELLS, len(self.values))
        small = functional.interpolate(torch.from_numpy(self.values)[None, None].float(), (cells,) * 3, mode="area")
        values = small[0, 0].numpy()
        if not (values < 0).any():
            return None
        vertices, faces, _, _ = marching_cubes(np.pad(values, 1, constant_values=1.0), 0.0)
        return RayTracer(((vertices - 0.5) * (2 / cells) - 1).astype(np.float32), faces)


def cell_centers(count: int) -> np.ndarray:
    """The centers [count] of equal cells of [-1, 1]."""
    return (np.arange(count) + 0.5) / count * 2 - 1


def sampled(values: Tensor, points: Tensor) -> Tensor:
    """Values [...] at points [..., d] of a grid values [n, ..., n] at the centers of n^d cells of [-1, 1]^d; d is 2 or 3.

    They are interpolated. Outside, they are those of the border.
    """
    d = values.dim()
    place = points.flip(-1).reshape(1, *(1,) * (d - 1), -1, d)
    found = functional.grid_sample(values[None, None], place, align_corners=False, padding_mode="border")
    return found.reshape(points.shape[:-1])


def distances_to(cells: np.ndarray, width: float) -> np.ndarray:
    """The distance [n, ...] of the center of each cell from the border of some cells [n, ...] bool.

    width: that of a cell. The distance transform gives the distance to the center of the nearest of the cells. Their border
    lies half a cell nearer.
    """
    return (ndimage.distance_transform_edt(~cells) - 0.5) * width


def signed_distances(solid: np.ndarray, width: float) -> np.ndarray:
    """The signed distance [n, ...] from the border of the solid cells [n, ...] bool, negative inside; all 1 without any."""
    if not solid.any():
        return np.full(solid.shape, _NOWHERE)
    return np.where(solid, -distances_to(~solid, width), distances_to(solid, width))
