"""The neural plenoptic function f_p(x, d): what light arrives at a surface point x from direction d (paper, eq. 6).

A ray that leaves the object returns the environment field F_e through a cone, plus a residual for distant light that no
photo shows; a ray that meets the mesh again returns the radiance reflected there, by the rendering equation, down to N
levels, and below that the terminal MLP.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
from torch import Tensor, nn

from blender_nep.geometry.ray_tracing import RayTracer
from blender_nep.shading import brdf
from blender_nep.shading.cones import diffuse_cones, specular_cones
from blender_nep.shading.unseen_light import UnseenLight

_CHUNK = 1 << 16


class Environment(Protocol):
    """What is asked of F_e."""

    def query_cone(self, origins: Tensor, directions: Tensor, half_angle: Tensor) -> tuple[Tensor, Tensor]:
        """Mean radiance [n,3] in a cone, and how far photos saw it [n] in 0..1."""
        ...

    def typical_distance(self) -> float:
        """Distance from the object's center to what the photos show, unit frame."""
        ...


@dataclass
class Material:
    """Principled inputs at points: albedo [n,3], roughness [n], metallic [n], linear, 0..1."""

    albedo: Tensor
    roughness: Tensor
    metallic: Tensor


@dataclass
class SurfacePoints:
    """Points of the mesh and the unit directions from which they are looked at."""

    position: Tensor
    """[n,3]"""
    face: np.ndarray
    """[n] int"""
    normal: Tensor
    """[n,3] smooth, unit, on the side of the eye"""
    view: Tensor
    """[n,3] towards the eye, unit"""

    def __len__(self) -> int:
        return len(self.position)

    def __getitem__(self, index: Tensor) -> SurfacePoints:
        i = index.cpu().numpy()
        return SurfacePoints(self.position[index], self.face[i], self.normal[index], self.view[index])

    @classmethod
    def joined(cls, parts: Sequence[SurfacePoints]) -> SurfacePoints:
        """One after the other."""
        return cls(
            torch.cat([part.position for part in parts]),
            np.concatenate([part.face for part in parts]),
            torch.cat([part.normal for part in parts]),
            torch.cat([part.view for part in parts]),
        )


@dataclass
class TraceResult:
    """What rays from surface points met: F_e's light where they leave, the next surface point where they do not."""

    radiance: Tensor
    """[n,3] from F_e; 0 where the ray hits the mesh"""
    coverage: Tensor
    """[n] how far photos saw that light; 1 where the ray hits the mesh"""
    row: Tensor
    """[k] int64: which rays hit"""
    hits: SurfacePoints
    """[k] where"""


class TerminalRadiance(nn.Module):
    """MLP(x, d): radiance that the surface sends out, where the recursion ends. Learned from the photos themselves."""

    octaves = 4

    def __init__(self, width: int = 48):
        super().__init__()
        inputs = 3 + 6 * self.octaves + 3 + 3
        self.net = nn.Sequential(
            nn.Linear(inputs, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU(), nn.Linear(width, 3)
        )

    def forward(self, points: SurfacePoints) -> Tensor:
        """Radiance [n,3] >= 0."""
        return torch.expm1(self.log_radiance(points)).clamp(0, 1e4) / 4

    def log_radiance(self, points: SurfacePoints) -> Tensor:
        """log(1 + 4 radiance): the photometric space, up to a factor."""
        scaled = points.position[:, None] * (2.0 ** torch.arange(self.octaves, device=points.position.device))[:, None]
        encoded = torch.cat([scaled.sin().flatten(1), scaled.cos().flatten(1)], 1)
        mirrored = brdf.reflect(points.view, points.normal)
        return nn.functional.softplus(self.net(torch.cat([points.position, encoded, points.normal, mirrored], 1)))


@dataclass(frozen=True)
class PlenopticSettings:
    """How deep f_p is evaluated, and by how many cones a surface point."""

    levels: int
    """N, the number of surface interactions computed by the rendering equation, counting the one that the eye sees (1: what
    a reflected ray hits comes from the terminal MLP; 0: hits stay black, the ablation without indirect light)"""
    diffuse: int
    """Cones of the diffuse lobe, where f_p is evaluated recursively"""
    specular: int
    """Cones of the specular lobe"""
    use_cones: bool = True
    """False: all cones are as narrow as a ray, the ablation"""


class PlenopticFunction:
    """f_p over one mesh and one environment field.

    materials_at(points) gives the current Material there.
    """

    def __init__(
        self,
        tracer: RayTracer,
        normals: np.ndarray,
        environment: Environment,
        terminal: TerminalRadiance,
        settings: PlenopticSettings,
        device: torch.device | str,
    ):
        self.tracer, self.normals, self.environment, self.terminal = tracer, normals, environment, terminal
        self.settings = settings
        self.device = torch.device(device)
        self.unseen: UnseenLight | None = None
        """Light that no photo shows; None until learned."""

    def points(self, face: np.ndarray, barycentric: np.ndarray, view: Tensor) -> SurfacePoints:
        """Surface points from a ray tracer's hits and the directions [n,3] towards the eye."""
        position = self.tracer.interpolate(self.tracer.vertices, face, barycentric).astype(np.float32)
        flat = torch.from_numpy(self.tracer.face_normals[face]).to(self.device)
        normal = torch.from_numpy(self.tracer.smooth_normals(self.normals, face, barycentric)).to(self.device)
        # A two-sided mesh: the normal is that of the side that is looked at.
        side = torch.where((flat * view).sum(-1, keepdim=True) < 0, -1.0, 1.0)
        return SurfacePoints(torch.from_numpy(position).to(self.device), face, facing(normal * side, view), view)

    @torch.no_grad()
    def trace(self, start: SurfacePoints, directions: Tensor, half_angle: Tensor) -> TraceResult:
        """Rays from start [n] along unit directions [n,3]: leave to F_e by cones of half_angle [n] or meet the mesh."""
        d = directions.cpu().numpy()
        origins = self.tracer.leave(start.position.cpu().numpy(), start.face, d)
        t, face, barycentric = self.tracer.intersect(origins, d)
        hit = np.isfinite(t)
        radiance = torch.zeros_like(directions)
        coverage = torch.ones(len(directions), device=self.device)
        free = torch.from_numpy(np.flatnonzero(~hit)).to(self.device)
        if not self.settings.use_cones:
            half_angle = torch.full_like(half_angle, 2e-3)
        for index in free.split(_CHUNK):
            radiance[index], coverage[index] = self.environment.query_cone(
                start.position[index], directions[index], half_angle[index]
            )
        row = torch.from_numpy(np.flatnonzero(hit)).to(self.device)
        hits = self.points(face[hit], barycentric[hit], -directions[row])
        return TraceResult(radiance.clamp_min(0), coverage.clamp(0, 1), row, hits)

    @torch.no_grad()
    def outgoing(
        self,
        points: SurfacePoints,
        materials_at: Callable[[SurfacePoints], Material],
        level: int,
        generator: torch.Generator,
    ) -> Tensor:
        """Radiance [n,3] that points send to their eye: the rendering equation at `level`, recursively (eq. 7)."""
        if self.settings.levels == 0:
            return torch.zeros_like(points.position)
        if level > self.settings.levels:
            return torch.cat(
                [self.terminal(points[i]) for i in torch.arange(len(points)).split(_CHUNK)]
                or [torch.zeros_like(points.position)]
            )
        step = _CHUNK // (self.settings.diffuse + self.settings.specular)
        parts = [
            self._outgoing(points[i], materials_at, level, generator)
            for i in torch.arange(len(points), device=self.device).split(step)
        ]
        return torch.cat(parts) if parts else torch.zeros_like(points.position)

    def incoming(
        self,
        start: SurfacePoints,
        directions: Tensor,
        half_angle: Tensor,
        materials_at: Callable[[SurfacePoints], Material],
        level: int,
        generator: torch.Generator,
    ) -> Tensor:
        """f_p [n,3] at start along directions; level is that of the surface the light falls on (1: seen by the eye)."""
        traced = self.trace(start, directions, half_angle)
        radiance = traced.radiance
        if self.unseen is not None:
            far = (traced.coverage < 1).nonzero().squeeze(-1)
            more = self.unseen(start.position[far], directions[far], half_angle[far])
            radiance[far] += more * (1 - traced.coverage[far])[:, None]
        if len(traced.row):
            radiance[traced.row] = self.outgoing(traced.hits, materials_at, level + 1, generator)
        return radiance

    def _outgoing(
        self,
        points: SurfacePoints,
        materials_at: Callable[[SurfacePoints], Material],
        level: int,
        generator: torch.Generator,
    ) -> Tensor:
        n, diffuse, specular = len(points), self.settings.diffuse, self.settings.specular
        material = materials_at(points)
        frame = brdf.frame(points.normal)
        v = local(frame, points.view)
        turn = torch.rand(n, 2, 2, generator=generator).to(self.device)
        s, weight, cos_vh, s_angle = specular_cones(v, material.roughness, specular, turn[:, 0])
        d, d_angle = diffuse_cones(diffuse, turn[:, 1])
        directions = torch.einsum("nij,nkj->nki", frame, torch.cat([s, d], 1))
        angle = torch.cat([s_angle, d_angle], 1)
        each = torch.arange(n, device=self.device).repeat_interleave(specular + diffuse)
        light = self.incoming(points[each], directions.reshape(-1, 3), angle.reshape(-1), materials_at, level, generator)
        light = light.reshape(n, -1, 3)
        spec, diff = light[:, :specular], light[:, specular:].sum(1) / max(diffuse, 1)
        moments = SpecularMoments(*((w[..., None] * spec).sum(1) for w in moment_weights(weight, cos_vh)))
        return reflected(material, moments, diff, v[:, 2])


@dataclass
class SpecularMoments:
    """Light through the specular lobe, by what the Fresnel term makes of it, each [..., 3] (split-sum)."""

    full: Tensor
    """with F = 1"""
    edge: Tensor
    """with F = (1 - v.h)^5"""
    dielectric: Tensor
    """with the dielectric's Fresnel reflectance"""


def moment_weights(weight: Tensor, cos_vh: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Weights of one sample in the three moments, from its G2 / G1 weight and the cosine of v.h."""
    return weight, weight * brdf.schlick_weight(cos_vh), weight * brdf.dielectric_fresnel(cos_vh)


def reflected(material: Material, specular: SpecularMoments, diffuse: Tensor, cos_v: Tensor) -> Tensor:
    """Radiance [n,3] towards the eye from the lobes' prefiltered light; diffuse [n,3] is irradiance over pi."""
    offset, slope = affine_in_albedo(material, specular, diffuse, cos_v)
    return offset + slope * material.albedo


def affine_in_albedo(material: Material, specular: SpecularMoments, diffuse: Tensor, cos_v: Tensor) -> tuple[Tensor, Tensor]:
    """The reflected radiance as offset + slope * albedo, [n,3] each: what the albedo is solved from.

    Exact but for the light that a metal scatters more than once, which is taken at the material's present albedo.
    """
    r, m, c = material.roughness[:, None], material.metallic[:, None], cos_v[:, None]
    more = brdf.multiscatter_scale(brdf.metal_fss(material.albedo), c, r)
    coat = specular.dielectric * brdf.multiscatter_scale(brdf.DIELECTRIC_FSS, c, r)
    base = diffuse * (1 - brdf.dielectric_albedo(c, r))
    return m * more * specular.edge + (1 - m) * coat, m * more * (specular.full - specular.edge) + (1 - m) * base


def local(frame: Tensor, directions: Tensor) -> Tensor:
    """Directions [n,3] in frames [n,3,3] whose columns are tangent, bitangent, normal."""
    return torch.einsum("nij,ni->nj", frame, directions)


def facing(normal: Tensor, view: Tensor, least: float = 0.02) -> Tensor:
    """Smooth normals [n,3] tilted until they face the eye: interpolated ones may look away at a silhouette."""
    cosine = (normal * view).sum(-1, keepdim=True)
    return nn.functional.normalize(normal + (least - cosine).clamp_min(0) * view, dim=-1)
