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
from blender_nep.shading.cones import cone_of_density, diffuse_cones, specular_cones
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

    _STATE = ("direct_specular", "direct_diffuse", "coverage", "residual_specular", "residual_diffuse", "slot",
              "slot_weight")

    def __init__(self, plenoptic: PlenopticFunction, points: SurfacePoints, ladder: tuple[float, ...]):
        """Without light yet: see `gathered` and `restored`. points: the n surface points."""
        self.plenoptic, self.points = plenoptic, points
        self.ladder = torch.tensor(ladder, device=points.position.device)
        self.cos_v = (points.normal * points.view).sum(-1)

    @classmethod
    def gathered(cls, plenoptic: PlenopticFunction, points: SurfacePoints, ladder: tuple[float, ...], lobes: int,
                 generator: torch.Generator, progress: Callable[[float], None]) -> IncomingLight:
        """Traces every cone once; progress(share done) is called after each chunk. lobes: of the residual."""
        light = cls(plenoptic, points, ladder)
        device, n, rungs = points.position.device, len(points), len(ladder)
        light.residual = DistantResidual.zeros(lobes, device)
        light.direct_specular = torch.zeros(n, rungs, 3, 3, device=device)
        """[n,R,moment,channel] from F_e"""
        light.direct_diffuse = torch.zeros(n, 3, device=device)
        light.coverage = torch.ones(n, rungs, device=device)
        """[n,R] share of the specular light that photos saw"""
        light.residual_specular = torch.zeros(n, rungs, lobes, device=device)
        light.residual_diffuse = torch.zeros(n, lobes, device=device)
        light.rays = 0
        found = []
        for rows in torch.arange(n, device=device).split(2048):
            found.append(light._gather(rows, generator))
            progress((int(rows[-1]) + 1) / n)
        slots, weights, hits = zip(*found, strict=True)
        light.slot, light.slot_weight = torch.cat(slots), torch.cat(weights)
        light.hits = SurfacePoints(torch.cat([h.position for h in hits]), np.concatenate([h.face for h in hits]),
                                   torch.cat([h.normal for h in hits]), torch.cat([h.view for h in hits]))
        light.specular, light.diffuse = light.direct_specular.clone(), light.direct_diffuse.clone()
        return light

    def state(self) -> dict:
        """What was traced, for a checkpoint."""
        hits = {"position": self.hits.position, "face": torch.from_numpy(self.hits.face.astype(np.int64)),
                "normal": self.hits.normal, "view": self.hits.view}
        return {"rays": self.rays, "hits": hits, **{name: getattr(self, name) for name in self._STATE}}

    @classmethod
    def restored(cls, plenoptic: PlenopticFunction, points: SurfacePoints, ladder: tuple[float, ...], state: dict
                 ) -> IncomingLight:
        """The inverse of `state`, for the same points and ladder."""
        light = cls(plenoptic, points, ladder)
        device = points.position.device
        for name in cls._STATE:
            setattr(light, name, state[name].to(device))
        light.rays, hits = state["rays"], state["hits"]
        light.hits = SurfacePoints(hits["position"].to(device), hits["face"].cpu().numpy(), hits["normal"].to(device),
                                   hits["view"].to(device))
        light.residual = DistantResidual.zeros(light.residual_diffuse.shape[1], device)
        light.specular, light.diffuse = light.direct_specular.clone(), light.direct_diffuse.clone()
        return light

    def _gather(self, rows: Tensor, generator: torch.Generator) -> tuple[Tensor, Tensor, SurfacePoints]:
        """Traces the cones of some rows; returns those that met the mesh: row, weights [k,1+R,3], where."""
        points, f_p = self.points[rows], self.plenoptic
        n, device = len(rows), rows.device
        frame = brdf.frame(points.normal)
        v = torch.einsum("nij,ni->nj", frame, points.view)
        direction, angle, weight = self._cones(v, generator)
        # A cone of no weight (below the horizon) need not be traced.
        live = (weight[:, :, 0, 0] > 0).reshape(-1).nonzero().squeeze(-1)
        each = live // direction.shape[1]
        direction = torch.einsum("nij,nj->ni", frame[each], direction.reshape(-1, 3)[live])
        weight = weight.flatten(0, 1)[live]
        arrival = f_p.trace(points[each], direction, angle.reshape(-1)[live])
        self.rays += len(live)

        def gather(values: Tensor) -> Tensor:
            return torch.zeros(n, *values.shape[1:], device=device).index_add_(0, each, values)

        total = gather(weight[..., None] * arrival.radiance[:, None, None, :])
        self.direct_diffuse[rows], self.direct_specular[rows] = total[:, 0, 0], total[:, 1:]
        seen = gather(weight[:, 1:, 0] * arrival.coverage[:, None])
        self.coverage[rows] = seen / gather(weight[:, 1:, 0]).clamp_min(1e-9)
        if self.residual_diffuse.shape[1]:
            basis = self.residual.basis(direction, arrival.coverage)
            lobes = torch.stack([gather(weight[:, k, :1] * basis) for k in range(weight.shape[1])], 1)
            self.residual_diffuse[rows], self.residual_specular[rows] = lobes[:, 0], lobes[:, 1:]
        return rows[0] + each[arrival.row], weight[arrival.row], arrival.hits

    def _cones(self, v: Tensor, generator: torch.Generator) -> tuple[Tensor, Tensor, Tensor]:
        """Cones for local views v [n,3]: all lobes' samples serve all lobes, by the balance heuristic (Veach 1995).

        Returns local directions [n,C,3], half-angles [n,C] and weights [n,C,1+R,3]: the diffuse lobe (its weight thrice)
        and the three moments of each rung. A lobe's weights are scaled to its exact albedo, so that a white furnace is
        exact; a cone is as wide as its share of all samples around it.
        """
        f_p, n, rungs = self.plenoptic, len(v), len(self.ladder)
        turn = torch.rand(n, rungs + 1, 2, generator=generator).to(v.device)
        specular = specular_cones(v[:, None].expand(n, rungs, 3), self.ladder.expand(n, rungs), f_p.specular,
                                  turn[:, 1:])[0]
        direction = torch.cat([diffuse_cones(f_p.diffuse, turn[:, 0])[0], specular.reshape(n, -1, 3)], 1)
        cos_v, cos_l = v[:, None, 2], direction[..., 2]
        h = torch.nn.functional.normalize(v[:, None] + direction, dim=-1)
        cos_h, cos_vh = h[..., 2].clamp(0, 1), (v[:, None] * h).sum(-1)
        above = cos_l > 0
        cosine = cos_l.clamp_min(0) / math.pi
        density, lobes = f_p.diffuse * cosine, [cosine]
        for roughness in self.ladder:
            alpha = brdf.alpha_of(roughness)
            density = density + f_p.specular * brdf.vndf_pdf(cos_v, cos_h, alpha)
            lobes.append(brdf.specular(cos_v.expand_as(cos_l), cos_l, cos_h, alpha) * cos_l.clamp_min(0))
        density = density.clamp_min(1e-9)
        weight = torch.stack(lobes, -1) / density[..., None] * above[..., None]
        albedo = torch.cat([torch.ones(n, 1, device=v.device), brdf.specular_albedo(cos_v, self.ladder)], 1)
        weight = weight * (albedo / weight.sum(1).clamp_min(1e-6))[:, None].clamp_max(1e3)
        fresnel = torch.stack(moment_weights(torch.ones_like(cos_vh), cos_vh), -1)
        return direction, cone_of_density(density), self._with_fresnel(weight, fresnel)

    @staticmethod
    def _with_fresnel(weight: Tensor, fresnel: Tensor) -> Tensor:
        """Weights [n,C,1+R] times the moments' Fresnel terms [n,C,3]; the diffuse lobe has none."""
        out = weight[..., None] * fresnel[:, :, None]
        out[:, :, 0] = weight[:, :, :1]
        return out

    def update(self, materials_at: Callable[[SurfacePoints], Material], generator: torch.Generator) -> None:
        """The moments under the current materials (what the object sends to itself) and the current residual."""
        specular, diffuse = self.direct_specular.clone(), self.direct_diffuse.clone()
        weights = self.residual.weights
        if weights.any():
            full = self.residual_specular @ weights
            specular += full[:, :, None, :] * self.uniform[..., None]
            diffuse += self.residual_diffuse @ weights
        if len(self.slot) and self.plenoptic.levels > 0:
            light = self.plenoptic.outgoing(self.hits, materials_at, 2, generator)
            for part in torch.arange(len(light), device=light.device).split(1 << 15):
                share = self.slot_weight[part, ..., None] * light[part, None, None, :]
                diffuse.index_add_(0, self.slot[part], share[:, 0, 0])
                specular.index_add_(0, self.slot[part], share[:, 1:])
        self.specular, self.diffuse = specular, diffuse

    @property
    def uniform(self) -> Tensor:
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
