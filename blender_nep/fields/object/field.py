"""The object field F_o: an SDF in the unit sphere, and the decomposed color c_o = c_a * c_l of its surface (eq. 3).

The SDF is a sum of quadratic B-spline volumes from coarse to fine. The sum is as expressive as the finest grid alone. But a
step on a coarse level moves the surface as a whole; this preconditioning keeps the grid smooth when it learns from
reflections. The color is evaluated once for each ray, at the composited surface point and normal.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import nn

from blender_nep.capture.rays.rigid_motions import RigidMotions
from blender_nep.evidence.sdf_grid import cell_centers
from blender_nep.fields.object.albedo_detail import AlbedoDetail
from blender_nep.fields.object.fine_level import FineLevel
from blender_nep.fields.object.volume_rendering import SurfaceSamples, render_surface, sphere_interval
from blender_nep.ops.object import bspline
from blender_nep.ops.object.bspline_bricks import Bricks, sample_bricks
from blender_nep.ops.object.bspline_march import march
from blender_nep.ops.object.encodings import encoding_size, integrated_directional_encoding, positional_encoding
from blender_nep.optimizers import Optimizer, UniformAdam
from blender_nep.support.plane import Support

FEATURES = 16
"""Number of values that the albedo head passes to the light head."""
ALBEDO_OCTAVES, LIGHT_OCTAVES, VIEW_OCTAVES = 5, 1, 4
"""Octaves of the positional encodings: of the point for the albedo head, of the point for the light head, and of the view
direction when the color is not decomposed. The light head has fewer, because light varies slowly from point to point."""

REFERENCE_CELL = 2 / 64
"""Cell width in object radii of the SDF level whose step size is the learning rate. Other levels' step sizes follow it."""


@dataclass
class Appearance:
    """Decomposed color of surface points: albedo c_a [n, 3] in 0..1, light c_l [n, 3] >= 0, roughness r [n, 1]."""

    albedo: torch.Tensor
    light: torch.Tensor
    roughness: torch.Tensor

    @property
    def color(self) -> torch.Tensor:
        """c_o = c_a * c_l (eq. 3), linear radiance."""
        return self.albedo * self.light


class Paint(NamedTuple):
    """What of a surface point's color depends neither on the normal nor on the view."""

    albedo: torch.Tensor
    """[n, 3] in 0..1"""
    roughness: torch.Tensor
    """[n, 1] in 0..1"""
    feature: torch.Tensor
    """[n, FEATURES], for the light head"""


def _mlp(inputs: int, width: int, outputs: int, hidden: int) -> nn.Sequential:
    layers = [nn.Linear(inputs, width), nn.ReLU()]
    for _ in range(hidden - 1):
        layers += [nn.Linear(width, width), nn.ReLU()]
    return nn.Sequential(*layers, nn.Linear(width, outputs))


class SurfaceColor(nn.Module):
    """The color of F_o's surface. Two MLPs with `hidden` hidden layers of `width` compute it.

    If `decomposed`, the color is c_a * c_l (eq. 3). If not, the albedo is 1, and the light head gives radiance, as in NeuS.
    """

    def __init__(self, width: int, decomposed: bool, hidden: int = 2) -> None:
        super().__init__()
        self.surface_head = _mlp(3 + 6 * ALBEDO_OCTAVES, width, 4 + FEATURES, hidden)
        self.decomposed = decomposed
        directional = encoding_size(4) if decomposed else 3 + 6 * VIEW_OCTAVES
        light_inputs = FEATURES + directional + 3 + 3 + 6 * LIGHT_OCTAVES
        self.light_head = _mlp(light_inputs, width, 3, hidden)
        self.albedo_detail: AlbedoDetail | None = None
        """Paint that is finer than what the MLPs can paint; None if the object has none."""

    def appearance(
        self,
        points: torch.Tensor,
        normals: torch.Tensor,
        directions: torch.Tensor,
        motion: RigidMotions | None = None,
    ) -> Appearance:
        """Color of surface points [n, 3] with unit normals, seen along unit view directions [n, 3] (camera to point).

        `motion` are n motions of the object to the room, where the light stands still. None: the object stands still.
        """
        paint = self.paint(points)
        if motion is not None:
            points, normals, directions = motion.points(points), motion.directions(normals), motion.directions(directions)
        return self.lit(paint, points, normals, directions)

    def paint(self, points: torch.Tensor) -> Paint:
        """What does not depend on normal and view at points [n, 3]."""
        raw = self.surface_head(positional_encoding(points, ALBEDO_OCTAVES))
        logits, roughness, feature = raw[:, :3], raw[:, 3:4].sigmoid(), raw[:, 4:]
        if self.albedo_detail is not None:
            logits = logits + self.albedo_detail(points)
        return Paint(logits.sigmoid(), roughness, feature)

    def lit(self, paint: Paint, points: torch.Tensor, normals: torch.Tensor, directions: torch.Tensor) -> Appearance:
        """The appearance of points [n, 3] of that paint, as `appearance`. All arguments are those in the room's frame."""
        albedo, roughness, feature = paint
        if self.decomposed:
            cosine = (directions * normals).sum(-1, keepdim=True)
            directional = integrated_directional_encoding(directions - 2 * cosine * normals, roughness)
        else:
            albedo, directional = torch.ones_like(albedo), positional_encoding(directions, VIEW_OCTAVES)
        light = self.light_head(torch.cat([feature, directional, normals, positional_encoding(points, LIGHT_OCTAVES)], -1))
        return Appearance(albedo, nn.functional.softplus(light), roughness)

    def color_parameters(self) -> list[nn.Parameter]:
        """The parameters of both MLPs and of the albedo's detail."""
        detail = [] if self.albedo_detail is None else [*self.albedo_detail.parameters()]
        return [*self.surface_head.parameters(), *self.light_head.parameters(), *detail]


@dataclass
class SplineShape:
    """The SDF in its present state. All questions of a step use the same coefficients [N, N, N], which are summed once."""

    coefficients: torch.Tensor
    support: Support | None = None
    """The plane on which the object stands. It hides what the SDF is below it."""
    fine: Bricks | None = None
    """What the fine level adds to the SDF near the surface, if there is such a level."""

    def __post_init__(self) -> None:
        self._spline = bspline.Spline(self.coefficients)

    @property
    def cell(self) -> float:
        """Width of the finest cells in the unit frame."""
        return 2.0 / (self.coefficients.shape[0] - 2 if self.fine is None else self.fine.cells)

    def sample(self, points: torch.Tensor, hessian: bool = False) -> torch.Tensor:
        """Value and derivatives of the SDF at points [n, 3], which get no gradient: as `Spline.sample`."""
        points = points.detach().clamp(-1, 1)
        sampled = self._spline.sample(points, hessian)
        return sampled if self.fine is None else sampled + sample_bricks(self.fine, points, hessian)

    def march(self, origins, directions, entry, leave, band: float, step: float) -> tuple[torch.Tensor, torch.Tensor]:
        """The spans of rays in which |SDF| < band: as `bspline_march.march`."""
        return march(self.coefficients, origins, directions, entry, leave, band, step, fine=self.fine)

    def interval(self, origins: torch.Tensor, directions: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Where rays [n, 3] are in the part of the unit sphere that can hold the object.

        Returns the distances [n] at which they enter and leave that part (equal where they miss it), and whether they leave
        it through the support plane [n] bool.
        """
        entry, leave = sphere_interval(origins, directions)
        if self.support is None:
            return entry, leave, torch.zeros_like(entry, dtype=torch.bool)
        normal = torch.as_tensor(self.support.normal, dtype=origins.dtype, device=origins.device)
        cosine = directions @ normal
        t = (self.support.height - origins @ normal) / cosine.clamp(max=-1e-6)
        meets = (cosine < -1e-6) & (leave > entry) & (t < leave)
        return entry, torch.where(meets, torch.maximum(t, entry), leave), meets & (t > entry)

    def render(
        self,
        origins: torch.Tensor,
        directions: torch.Tensor,
        sharpness: float,
        samples: int,
        generator: torch.Generator | None,
    ) -> SurfaceSamples:
        """The surface composited along rays [n, 3]. Rays that meet no surface are left out. See `render_surface`."""
        interval = self.interval(origins, directions)[:2]
        return render_surface(self, origins, directions, sharpness, samples, generator, interval)

    def bending(self, points: torch.Tensor) -> torch.Tensor:
        """Squared norm [n] of the SDF's Hessian at points [n, 3]. The points get no gradient."""
        hessian = self.sample(points, hessian=True)[:, 4:]
        return (hessian[:, :3] ** 2).sum(1) + 2 * (hessian[:, 3:] ** 2).sum(1)

    def near(self, origins: torch.Tensor, directions: torch.Tensor, band: float) -> torch.Tensor:
        """Whether each ray [n, 3] comes nearer to the surface than `band` (unit frame): [n] bool."""
        entry, leave, _ = self.interval(origins, directions)
        return self.march(origins, directions, entry, leave, band, 0.5 * band)[1] > 0


class ObjectField(SurfaceColor):
    """The object field F_o in the unit sphere. The coarsest SDF level has cells^3 cells; each `add_level` halves the cell.

    The SDF starts as a sphere of `initial_radius` in the unit frame.
    """

    def __init__(self, cells: int, initial_radius: float, width: int = 64, decomposed: bool = True) -> None:
        super().__init__(width, decomposed)
        center = (torch.arange(cells + 2) - 0.5) / cells * 2 - 1
        x, y, z = torch.meshgrid(center, center, center, indexing="ij")
        self.levels = nn.ParameterList([nn.Parameter((x * x + y * y + z * z).sqrt() - initial_radius)])
        self.fine: FineLevel | None = None
        """A finer level where relief was found (`relief.find_relief`); None if none was found."""
        self._support: Support | None = None

    @property
    def support(self) -> Support | None:
        """The plane on which the object stands; None as long as none is known."""
        return self._support

    def stand_on(self, support: Support | None) -> None:
        """Let the object end at this plane from now on. None: let it end at the unit sphere only."""
        self._support = support

    @property
    def level_count(self) -> int:
        """Number of SDF levels at present."""
        return len(self.levels)

    def shape(self) -> SplineShape:
        """The SDF in its present state."""
        return SplineShape(self.coefficients(), self.support, None if self.fine is None else self.fine.bricks)

    def shape_optimizer(self, rate: float, betas: tuple[float, float]) -> Optimizer:
        """Adam with one step size for each level, for the present parameters of the SDF.

        A level whose cells are REFERENCE_CELL wide has the step size `rate`. The step size of another level is proportional
        to its cell width.
        """
        levels = [(level, 2 / (level.shape[0] - 2)) for level in self.levels]
        if self.fine is not None:
            levels.append((self.fine.coefficients, 2 / self.fine.cells))
        groups = [{"params": [level], "scale": cell / REFERENCE_CELL} for level, cell in levels]
        return UniformAdam(groups, lr=rate, betas=betas)

    def add_level(self) -> None:
        """Add a level of half the cell size. It is zero everywhere, so that the SDF does not change."""
        n = 2 * self.levels[-1].shape[0] - 2
        device = self.levels[-1].device
        self.levels.append(nn.Parameter(torch.zeros(n, n, n, device=device)))

    def add_levels(self, count: int) -> None:
        """Add levels until there are `count`."""
        while self.level_count < count:
            self.add_level()

    def structure(self) -> dict:
        """Which parameters this field has, for `grow`."""
        return {
            "levels": self.level_count,
            "fine": None if self.fine is None else {"cells": self.fine.cells, "bricks": len(self.fine.coefficients)},
            "albedo_detail": self.albedo_detail is not None,
        }

    def grow(self, structure: dict) -> None:
        """Get the parameters of a field of that `structure`, so that its state can be loaded."""
        self.add_levels(structure["levels"])
        if structure["fine"] is not None:
            self.fine = FineLevel(**structure["fine"], device=self.levels[0].device)
        if structure["albedo_detail"]:
            self.add_albedo_detail()

    def add_albedo_detail(self) -> None:
        """Add a grid of fine paint, which is zero everywhere, so that no color changes."""
        if self.albedo_detail is None:
            self.albedo_detail = AlbedoDetail().to(self.levels[0].device)

    @torch.no_grad()
    def start_from(self, sdf: torch.Tensor) -> None:
        """Set the SDF to values [n, n, n] at the centers of the finest level's cells. Raises ValueError for another n."""
        n = self.levels[-1].shape[0] - 2
        if sdf.shape != (n, n, n):
            raise ValueError(f"an SDF of {n}^3 cells is needed, not {tuple(sdf.shape)}")
        # each coefficient lies at the center of its cell, and there is one more beyond each border
        target = nn.functional.pad(sdf[None, None], (1,) * 6, mode="replicate")[0, 0]
        coarse = nn.functional.interpolate(sdf[None, None], self.levels[0].shape[0] - 2, mode="area")
        self.levels[0].copy_(nn.functional.pad(coarse, (1,) * 6, mode="replicate")[0, 0])
        for level in self.levels[1:]:
            level.zero_()
        self.levels[-1].add_(target - self.coefficients())

    @torch.no_grad()
    def add(self, difference: torch.Tensor) -> None:
        """Add values [n, n, n] to the SDF, smoothed by the spline. They belong to the centers of the finest cells."""
        self.levels[-1][1:-1, 1:-1, 1:-1] += difference

    @property
    def cell(self) -> float:
        """Width of the finest level's cells in the unit frame."""
        return 2.0 / (self.levels[-1].shape[0] - 2)

    def coefficients(self) -> torch.Tensor:
        """Spline coefficients [N, N, N] of the whole SDF: the sum of all levels, on the finest level."""
        total = self.levels[0]
        for level in self.levels[1:]:
            total = bspline.refine(total, level)
        return total

    @torch.no_grad()
    def sdf(self, points: torch.Tensor) -> torch.Tensor:
        """Signed distance, negative inside: [n, 3] -> [n]."""
        return self.shape().sample(points)[:, 0]

    @torch.no_grad()
    def normal(self, points: torch.Tensor) -> torch.Tensor:
        """Unit normals, outward: [n, 3] -> [n, 3]."""
        gradient = self.shape().sample(points)[:, 1:4]
        return nn.functional.normalize(gradient, dim=-1)

    @torch.no_grad()
    def sdf_and_gradient(self, points: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Signed distance [n], negative inside, and its gradient [n, 3] at points [n, 3]."""
        sampled = self.shape().sample(points)
        return sampled[:, 0], sampled[:, 1:4]

    def sdf_in_cells(self, n: int | None = None) -> np.ndarray:
        """SDF [n, n, n] at the centers of n^3 cells, by default of the cells of `levels[-1]`; float32.

        It is 1 where no object can be: outside the sphere, and below the support plane.
        """
        n = n or round(2 / self.cell)
        axis = cell_centers(n).astype(np.float32)
        sdf = self._sdf_on(torch.from_numpy(axis))
        place = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1)
        nothing = np.linalg.norm(place, axis=-1) > 1
        if self.support is not None:
            nothing |= self.support.distance(place) < 0
        return np.where(nothing, np.float32(1), sdf)

    def sdf_grid(self, n: int) -> np.ndarray:
        """SDF on n^3 points spanning [-1, 1]^3, index order x, y, z; float32."""
        return self._sdf_on(torch.linspace(-1, 1, n))

    @torch.no_grad()
    def _sdf_on(self, axis: torch.Tensor) -> np.ndarray:
        """SDF [n, n, n] on the grid whose x, y and z are those of `axis` [n]."""
        axis, shape = axis.to(self.levels[0].device), self.shape()
        planes = []
        for x in axis:
            y, z = torch.meshgrid(axis, axis, indexing="ij")
            points = torch.stack([x.expand_as(y), y, z], -1).reshape(-1, 3)
            planes.append(shape.sample(points)[:, 0].reshape(y.shape).cpu().numpy())
        return np.stack(planes)
