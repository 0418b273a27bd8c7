"""What the photos show of points on a surface, and how well they agree on it."""

from __future__ import annotations

import numpy as np
import torch
from skimage.measure import marching_cubes
from torch import Tensor
from torch.nn import functional

from blender_nep.capture.cameras.upright import upward
from blender_nep.capture.rays.pixel_rays import PixelRays
from blender_nep.evidence.small_photos import SmallPhotos
from blender_nep.geometry.ray_tracing import RayTracer

LEAST_VIEWS = 4
"""A color of the surface is known if at least so many photos show it."""
_FACING = 0.15
"""A photo shows a point of the surface if the cosine of the viewing angle is at least this."""
_CELLS = 64
"""A surface is traced as a mesh from at most so many cells along a side."""


class SurfacePhotos:
    """What the photos show of points on a surface."""

    def __init__(self, rays: PixelRays) -> None:
        self._photos, self._device = SmallPhotos(rays), rays.radiance.device
        positions, rotations = zip(*(rays.camera(view) for view in self._photos.views), strict=True)
        self.cameras = torch.stack(positions).float().cpu()
        """[views, 3] positions"""
        axes = torch.stack(rotations).double().cpu().numpy()
        self.up = torch.from_numpy(upward(axes[:, :, 0], axes[:, :, 1])).float()
        """[3], the upward direction"""

    def colors(self, points: Tensor, normals: Tensor, shape: RayTracer, cell: float) -> Tensor:
        """Tone-mapped colors [views, n, 3] of surface points [n, 3]; NaN where a photo does not show the point.

        cell: how inexact the surface is.
        """
        colors = self._photos.colors(points.to(self._device)).cpu()
        start = points + cell * normals
        for view, camera in enumerate(self.cameras):
            towards = functional.normalize(camera - start, dim=-1)
            hidden = torch.from_numpy(shape.occluded(start.numpy(), towards.numpy()))
            hidden |= (towards * normals).sum(-1) < _FACING
            colors[view, hidden] = torch.nan
        return colors


def traced_mesh(sdf: np.ndarray) -> RayTracer | None:
    """The surface of an SDF [n, n, n]; None if nothing is inside."""
    cells = min(_CELLS, len(sdf))
    small = functional.interpolate(torch.from_numpy(sdf)[None, None].float(), (cells,) * 3, mode="area")[0, 0].numpy()
    if not (small < 0).any():
        return None
    small = np.pad(small, 1, constant_values=1.0)
    vertices, faces, _, _ = marching_cubes(small, 0.0)
    return RayTracer(((vertices - 0.5) * (2 / cells) - 1).astype(np.float32), faces)


def agreement(colors: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Median color [n, 3] of colors [views, n, 3], their median difference from it [n], and whether enough are known [n]."""
    median = colors.nanmedian(0).values
    spread = (colors - median).abs().mean(-1).nanmedian(0).values
    return median, spread, torch.isfinite(colors[..., 0]).sum(0) >= LEAST_VIEWS


def normals_of_cells(sdf: np.ndarray, place: np.ndarray) -> np.ndarray:
    """Unit normals [n, 3] float32 of cells [n, 3] of an SDF [N, N, N]."""
    gradient = np.stack([part[tuple(place.T)] for part in np.gradient(sdf)], -1)
    return (gradient / np.linalg.norm(gradient, axis=-1, keepdims=True).clip(1e-9)).astype(np.float32)
