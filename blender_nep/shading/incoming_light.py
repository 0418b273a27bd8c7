"""Prefiltered incoming light of surface points, for a ladder of roughnesses, computed once.

The mesh and F_e stand still while materials are learned. So the light through the GGX lobe of each ladder roughness, and
the diffuse irradiance, are gathered once by cones; the optimisation interpolates between the rungs. Only rays that meet
the object again depend on the materials: they are kept in a list and evaluated now and then.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from blender_nep.shading import brdf
from blender_nep.shading.cones import diffuse_cones, specular_cones
from blender_nep.shading.plenoptic import Material, PlenopticFunction, SpecularMoments, SurfacePoints, moment_weights

_FULL, _EDGE, _DIELECTRIC = range(3)


def directions_on_sphere(count: int) -> Tensor:
    """`count` nearly uniform unit directions [count,3] (Fibonacci's spiral)."""
    k = torch.arange(count) + 0.5
    z = 1 - 2 * k / count
    phi = math.pi * (1 + math.sqrt(5)) * k
    s = (1 - z * z).sqrt()
    return torch.stack([s * phi.cos(), s * phi.sin(), z], -1)


@dataclass
class DistantResidual:
    """Distant light that no photo shows: non-negative lobes over directions, seen where F_e's coverage is missing.

    Linear in `weights` [K,3]; a lobe is exp(k (d.a - 1)) with k such that neighbours overlap. Added to F_e's radiance,
    times (1 - coverage): where photos saw the light there is nothing to learn.
    """

    axes: Tensor
    weights: Tensor

    @classmethod
    def zeros(cls, count: int, device: torch.device) -> DistantResidual:
        return cls(directions_on_sphere(count).to(device), torch.zeros(count, 3, device=device))

    def basis(self, directions: Tensor, coverage: Tensor) -> Tensor:
        """Each lobe's value [n,K] for directions [n,3] with coverage [n]."""
        lobes = torch.exp(len(self.axes) / 4 * (directions @ self.axes.T - 1))
        return lobes * (1 - coverage)[:, None]

    def __call__(self, directions: Tensor, coverage: Tensor) -> Tensor:
        return self.basis(directions, coverage) @ self.weights


class IncomingLight:
    """Light moments of n surface points on a ladder of R roughnesses, plus the diffuse irradiance."""

    def __init__(self, plenoptic: PlenopticFunction, points: SurfacePoints, ladder: tuple[float, ...], lobes: int,
                 generator: torch.Generator, progress: Callable[[float], None]):
        """Traces every cone once. points: n surface points; progress(fraction) is called after each chunk."""
        device, n = points.position.device, len(points)
        self.plenoptic, self.points = plenoptic, points
        self.ladder = torch.tensor(ladder, device=device)
        self.cos_v = (points.normal * points.view).sum(-1)
        self.residual = DistantResidual.zeros(lobes, device)
        rungs = len(ladder)
        self.direct_specular = torch.zeros(n, rungs, 3, 3, device=device)
        """[n,R,moment,channel] from F_e"""
        self.direct_diffuse = torch.zeros(n, 3, device=device)
        self.coverage = torch.ones(n, rungs, device=device)
        """[n,R] share of the specular light that photos saw"""
        self.residual_specular = torch.zeros(n, rungs, lobes, device=device)
        self.residual_diffuse = torch.zeros(n, lobes, device=device)
        self._slot, self._slot_weight, self._hits = [], [], []
        self.rays = 0
        for rows in torch.arange(n, device=device).split(2048):
            self._gather(rows, generator)
            progress((int(rows[-1]) + 1) / n)
        self.slot = torch.cat(self._slot)
        self.slot_weight = torch.cat(self._slot_weight)
        self.hits = SurfacePoints(
            torch.cat([h.position for h in self._hits]), np.concatenate([h.face for h in self._hits]),
            torch.cat([h.normal for h in self._hits]), torch.cat([h.view for h in self._hits]))
        self._slot, self._slot_weight, self._hits = [], [], []
        self.specular, self.diffuse = self.direct_specular.clone(), self.direct_diffuse.clone()

    def _gather(self, rows: Tensor, generator: torch.Generator) -> None:
        points, f_p = self.points[rows], self.plenoptic
        n, device, rungs = len(rows), rows.device, len(self.ladder)
        frame = brdf.frame(points.normal)
        v = torch.einsum("nij,ni->nj", frame, points.view)
        turn = torch.rand(n, rungs + 1, 2, generator=generator).to(device)
        s, weight, cos_vh, s_angle = specular_cones(
            v[:, None].expand(n, rungs, 3), self.ladder.expand(n, rungs), f_p.specular, turn[:, 1:])
        d, d_angle = diffuse_cones(f_p.diffuse, turn[:, 0])
        direction = torch.cat([d.reshape(n, -1, 3), s.reshape(n, -1, 3)], 1)
        angle = torch.cat([d_angle.reshape(n, -1), s_angle.reshape(n, -1)], 1)
        moments = torch.stack(moment_weights(weight, cos_vh), -1).reshape(n, rungs * f_p.specular, 3)
        share = torch.cat([torch.full((n, f_p.diffuse, 3), 1 / f_p.diffuse, device=device), moments], 1)
        slot = torch.cat([torch.zeros(f_p.diffuse, dtype=torch.int64, device=device),
                          1 + torch.arange(rungs, device=device).repeat_interleave(f_p.specular)])
        # A cone of no weight (below the horizon) need not be traced.
        live = (share[..., 0] > 0).reshape(-1).nonzero().squeeze(-1)
        each = live // direction.shape[1]
        direction = torch.einsum("nij,nj->ni", frame[each], direction.reshape(-1, 3)[live])
        share, slot = share.reshape(-1, 3)[live], slot.repeat(n)[live]
        arrival = f_p.trace(points[each], direction, angle.reshape(-1)[live])
        self.rays += len(live)

        target = each * (rungs + 1) + slot
        total = torch.zeros(n * (rungs + 1), 3, 3, device=device)
        total.index_add_(0, target, share[:, :, None] * arrival.radiance[:, None, :])
        total = total.reshape(n, rungs + 1, 3, 3)
        self.direct_diffuse[rows], self.direct_specular[rows] = total[:, 0, 0], total[:, 1:]
        seen = torch.zeros(n * (rungs + 1), 2, device=device)
        seen.index_add_(0, target, share[:, :1] * torch.stack([arrival.coverage, torch.ones_like(each).float()], -1))
        seen = seen.reshape(n, rungs + 1, 2)
        self.coverage[rows] = (seen[..., 0] / seen[..., 1].clamp_min(1e-9))[:, 1:]
        unseen = (arrival.coverage < 0.99).nonzero().squeeze(-1)
        basis = torch.zeros(n * (rungs + 1), self.residual_diffuse.shape[1], device=device)
        basis.index_add_(0, target[unseen],
                         share[unseen, :1] * self.residual.basis(direction[unseen], arrival.coverage[unseen]))
        basis = basis.reshape(n, rungs + 1, -1)
        self.residual_diffuse[rows], self.residual_specular[rows] = basis[:, 0], basis[:, 1:]
        self._slot.append(rows[0] * (rungs + 1) + target[arrival.row])
        self._slot_weight.append(share[arrival.row])
        self._hits.append(arrival.hits)

    def update(self, materials_at: Callable[[SurfacePoints], Material], generator: torch.Generator) -> None:
        """The moments under the current materials (what the object sends to itself) and the current residual."""
        n, rungs = self.coverage.shape
        specular, diffuse = self.direct_specular.clone(), self.direct_diffuse.clone()
        weights = self.residual.weights
        if weights.any():
            full = self.residual_specular @ weights
            # The residual is smooth: its Fresnel moments are those of a uniform light.
            ratio = self._uniform / self._uniform[..., :1].clamp_min(1e-9)
            specular += full[:, :, None, :] * ratio[..., None]
            diffuse += self.residual_diffuse @ weights
        if len(self.slot) and self.plenoptic.levels > 0:
            light = self.plenoptic.outgoing(self.hits, materials_at, 2, generator)
            total = torch.zeros(n * (rungs + 1), 3, 3, device=diffuse.device)
            total.index_add_(0, self.slot, self.slot_weight[:, :, None] * light[:, None, :])
            total = total.reshape(n, rungs + 1, 3, 3)
            diffuse += total[:, 0, 0]
            specular += total[:, 1:]
        self.specular, self.diffuse = specular, diffuse

    @property
    def _uniform(self) -> Tensor:
        """Moments [n,R,3] of a light of 1 from everywhere, up to a factor: Schlick's mean at the mirror angle."""
        edge = brdf.schlick_weight(self.cos_v)
        dielectric = brdf.dielectric_fresnel(self.cos_v)
        return torch.stack([torch.ones_like(edge), edge, dielectric], -1)[:, None].expand(*self.coverage.shape, 3)

    def moments(self, roughness: Tensor, rows: Tensor | slice = slice(None)) -> SpecularMoments:
        """Moments of rows [m] at roughness [m] (or a scalar tensor), interpolated between the rungs."""
        low, mix = self.rung(roughness)
        table = self.specular[rows]
        if low.ndim == 0:
            between = torch.lerp(table[:, low], table[:, low + 1], mix)
        else:
            each = torch.arange(len(table), device=table.device)
            between = torch.lerp(table[each, low], table[each, low + 1], mix[:, None, None])
        return SpecularMoments(between[:, _FULL], between[:, _EDGE], between[:, _DIELECTRIC])

    def rung(self, roughness: Tensor) -> tuple[Tensor, Tensor]:
        """The rung below a roughness and how far it is to the next, 0..1."""
        low = (torch.searchsorted(self.ladder, roughness.contiguous(), right=True) - 1).clamp(0, len(self.ladder) - 2)
        span = self.ladder[low + 1] - self.ladder[low]
        return low, ((roughness - self.ladder[low]) / span).clamp(0, 1)
