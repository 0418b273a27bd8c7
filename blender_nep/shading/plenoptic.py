"""The neural plenoptic function f_p(x, d): the light that arrives at a surface point x from direction d (paper, eq. 6).

A ray that leaves the object gets the radiance of the support plane or of the environment field F_e in a cone, or the unseen
light where no photo shows the environment. A ray that meets the mesh again gets the radiance that the mesh reflects there.
That radiance comes from the rendering equation down to N levels, and below that from the terminal MLP.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from blender_nep.capture.rays.rigid_motions import RigidMotions
from blender_nep.geometry.ray_tracing import RayTracer
from blender_nep.shading import brdf
from blender_nep.shading.cones import diffuse_cones, specular_cones
from blender_nep.shading.environment import Environment
from blender_nep.shading.unseen_light import UnseenLight
from blender_nep.support.light import SupportLight

_CHUNK = 1 << 16


@dataclass
class Material:
    """Inputs of the Principled shader at n points: albedo [n, 3], roughness [n], metallic [n]; linear, 0..1."""

    albedo: Tensor
    roughness: Tensor
    metallic: Tensor


@dataclass
class SurfacePoints:
    """Points of the mesh, and for each the direction to the eye that sees it."""

    position: Tensor
    """[n, 3] unit frame"""
    face: np.ndarray
    """[n] int, index of the face"""
    normal: Tensor
    """[n, 3] smooth unit normals on the side of the eye"""
    view: Tensor
    """[n, 3] unit vectors towards the eye"""
    motion: RigidMotions | None = None
    """n motions to the room, where the light stands still: how the object stood when the eye saw the point. None: it always
    stood still"""

    def __len__(self) -> int:
        return len(self.position)

    def __getitem__(self, index: Tensor) -> SurfacePoints:
        i = index.cpu().numpy()
        return SurfacePoints(self.position[index], self.face[i], self.normal[index], self.view[index], self.motion_of(index))

    def motion_of(self, index: Tensor) -> RigidMotions | None:
        """The motions of the points index [m] int64; None if the object stood still."""
        return None if self.motion is None else self.motion[index]

    @property
    def room_position(self) -> Tensor:
        """[n, 3] the positions in the room's frame"""
        return self.position if self.motion is None else self.motion.points(self.position)

    def in_room(self, directions: Tensor) -> Tensor:
        """Directions [n, 3], one at each point, in the room's frame."""
        return directions if self.motion is None else self.motion.directions(directions)

    @classmethod
    def joined(cls, parts: Sequence[SurfacePoints]) -> SurfacePoints:
        """The points of all parts, one part after the other."""
        motions = [part.motion for part in parts if part.motion is not None]
        return cls(
            torch.cat([part.position for part in parts]),
            np.concatenate([part.face for part in parts]),
            torch.cat([part.normal for part in parts]),
            torch.cat([part.view for part in parts]),
            RigidMotions.joined(motions) if motions else None,
        )


@dataclass
class TraceResult:
    """The trace result of n rays from surface points: F_e's light for rays that leave, surface points for rays that hit."""

    radiance: Tensor
    """[n, 3] radiance of F_e, as far as photos show it; 0 where the ray hits the mesh"""
    coverage: Tensor
    """[n] coverage of that light by the photos, 0..1; 1 where the ray hits the mesh"""
    row: Tensor
    """[k] int64: indices of the rays that hit the mesh"""
    hits: SurfacePoints
    """[k] the points that they hit"""


class TerminalRadiance(nn.Module):
    """The terminal MLP(x, d): the radiance that surface points send to the eye. It ends the recursion of f_p.

    It is learned from the photos.
    """

    octaves = 4

    def __init__(self, width: int = 48):
        super().__init__()
        inputs = 3 + 6 * self.octaves + 3 + 3
        self.net = nn.Sequential(
            nn.Linear(inputs, width), nn.ReLU(), nn.Linear(width, width), nn.ReLU(), nn.Linear(width, 3)
        )

    def forward(self, points: SurfacePoints) -> Tensor:
        """Radiance [n, 3] >= 0 that the points send to the eye."""
        return torch.expm1(self.log_radiance(points)).clamp(0, 1e4) / 4

    def log_radiance(self, points: SurfacePoints) -> Tensor:
        """log(1 + 4 radiance) [n, 3]: the tone-mapped radiance up to a factor."""
        scaled = points.position[:, None] * (2.0 ** torch.arange(self.octaves, device=points.position.device))[:, None]
        encoded = torch.cat([scaled.sin().flatten(1), scaled.cos().flatten(1)], 1)
        normal, mirrored = points.in_room(points.normal), points.in_room(brdf.reflect(points.view, points.normal))
        return nn.functional.softplus(self.net(torch.cat([points.position, encoded, normal, mirrored], 1)))


@dataclass(frozen=True)
class PlenopticSettings:
    """How many levels f_p has, and how many cones a surface point has."""

    levels: int
    """N, the number of surface interactions by the rendering equation, with the one that the eye sees. With 1, the radiance
    of a point that a reflected ray hits comes from the terminal MLP. With 0, hits stay black (the ablation without indirect
    light)."""
    diffuse: int
    """Number of cones of the diffuse lobe, where f_p is evaluated recursively"""
    specular: int
    """Number of cones of the specular lobe"""
    use_cones: bool = True
    """False: all cones are as narrow as a ray (an ablation)"""


@dataclass(frozen=True, eq=False)
class PlenopticFunction:
    """The plenoptic function f_p for one mesh in one light.

    In its methods, materials_at(points) gives the present Material at surface points.
    """

    tracer: RayTracer
    normals: np.ndarray
    """[V, 3] unit normals of the mesh's vertices"""
    environment: Environment
    terminal: TerminalRadiance
    settings: PlenopticSettings
    device: torch.device | str
    support_light: SupportLight | None = None
    """The light of the plane on which the object stands. None if it stands on none"""
    unseen: UnseenLight | None = None
    """Light that no photo shows. None: there is none"""

    def points(
        self, face: np.ndarray, barycentric: np.ndarray, view: Tensor, motion: RigidMotions | None = None
    ) -> SurfacePoints:
        """Surface points from hits of the ray tracer, face [n] and barycentric [n, 3]; view [n, 3] points to the eye.

        `motion` are n motions to the room; None: the object stands still.
        """
        position = self.tracer.interpolate(self.tracer.vertices, face, barycentric).astype(np.float32)
        flat = torch.from_numpy(self.tracer.face_normals[face]).to(self.device)
        normal = torch.from_numpy(self.tracer.smooth_normals(self.normals, face, barycentric)).to(self.device)
        # The mesh is two-sided: the normal is that of the side that the eye sees.
        side = torch.where((flat * view).sum(-1, keepdim=True) < 0, -1.0, 1.0)
        return SurfacePoints(torch.from_numpy(position).to(self.device), face, facing(normal * side, view), view, motion)

    @torch.no_grad()
    def trace(self, start: SurfacePoints, directions: Tensor, half_angle: Tensor) -> TraceResult:
        """Trace rays from the points start [n] along unit directions [n, 3].

        A ray that leaves the object queries the support plane or F_e with a cone of half_angle [n] radians; other rays hit
        the mesh.
        """
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
            radiance[index], coverage[index] = self._surroundings(
                start.position[index], directions[index], half_angle[index], start.motion_of(index)
            )
        row = torch.from_numpy(np.flatnonzero(hit)).to(self.device)
        hits = self.points(face[hit], barycentric[hit], -directions[row], start.motion_of(row))
        return TraceResult(radiance.clamp_min(0), coverage.clamp(0, 1), row, hits)

    def _surroundings(
        self, origins: Tensor, directions: Tensor, half_angle: Tensor, motion: RigidMotions | None
    ) -> tuple[Tensor, Tensor]:
        """Mean radiance [n, 3] and coverage [n] of cones that leave the object: of the support plane, or of F_e.

        The plane turns with the object, if that turns. F_e stands still.
        """
        if self.support_light is None:
            return self._environment(origins, directions, half_angle, motion)
        radiance, meets = self.support_light.query_cone(origins, directions, half_angle)
        coverage = torch.ones_like(radiance[:, 0])
        far = (~meets).nonzero()[:, 0]
        moved = None if motion is None else motion[far]
        radiance[far], coverage[far] = self._environment(origins[far], directions[far], half_angle[far], moved)
        return radiance, coverage

    def _environment(
        self, origins: Tensor, directions: Tensor, half_angle: Tensor, motion: RigidMotions | None
    ) -> tuple[Tensor, Tensor]:
        """Mean radiance [n, 3] of F_e in cones that begin in the object's frame, and their coverage [n]."""
        if motion is not None:
            origins, directions = motion.points(origins), motion.directions(directions)
        return self.environment.query_cone(origins, directions, half_angle)

    @torch.no_grad()
    def outgoing(
        self,
        points: SurfacePoints,
        materials_at: Callable[[SurfacePoints], Material],
        level: int,
        generator: torch.Generator,
    ) -> Tensor:
        """Radiance [n, 3] that points send to the eye: the rendering equation (eq. 7) at `level`, evaluated recursively."""
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
        """f_p [n, 3]: the radiance that arrives at the points start [n] from directions [n, 3], in cones of half_angle [n].

        `level` is the level of these points; points that the eye sees have level 1. The object's frame has the directions.
        """
        traced = self.trace(start, directions, half_angle)
        radiance = traced.radiance
        if self.unseen is not None:
            far = (traced.coverage < 1).nonzero().squeeze(-1)
            seeing = start[far]
            more = self.unseen(seeing.room_position, seeing.in_room(directions[far]), half_angle[far])
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
    """Light through the specular lobe with three Fresnel terms F, each [..., 3] (split-sum)."""

    full: Tensor
    """The light with F = 1"""
    edge: Tensor
    """The light with F = (1 - v.h)^5"""
    dielectric: Tensor
    """The light with the Fresnel reflectance of a dielectric"""


def moment_weights(weight: Tensor, cos_vh: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Weights of one sample in the three moments, from its G2 / G1 weight and the cosine of v.h."""
    return weight, weight * brdf.schlick_weight(cos_vh), weight * brdf.dielectric_fresnel(cos_vh)


def reflected(material: Material, specular: SpecularMoments, diffuse: Tensor, cos_v: Tensor) -> Tensor:
    """Radiance [n, 3] towards the eye from the lobes' prefiltered light; diffuse [n, 3] is irradiance divided by pi."""
    offset, slope = affine_in_albedo(material, specular, diffuse, cos_v)
    return offset + slope * material.albedo


def affine_in_albedo(material: Material, specular: SpecularMoments, diffuse: Tensor, cos_v: Tensor) -> tuple[Tensor, Tensor]:
    """The reflected radiance as offset + slope * albedo; returns offset and slope [n, 3].

    This is exact except for the light that a metal scatters more than once: that light is taken at the material's present
    albedo.
    """
    r, m, c = material.roughness[:, None], material.metallic[:, None], cos_v[:, None]
    more = brdf.multiscatter_scale(brdf.metal_fss(material.albedo), c, r)
    coat = specular.dielectric * brdf.multiscatter_scale(brdf.DIELECTRIC_FSS, c, r)
    base = diffuse * (1 - brdf.dielectric_albedo(c, r))
    return m * more * specular.edge + (1 - m) * coat, m * more * (specular.full - specular.edge) + (1 - m) * base


def local(frame: Tensor, directions: Tensor) -> Tensor:
    """Directions [n, 3] in the local coordinates of frames [n, 3, 3], whose columns are tangent, bitangent, normal."""
    return torch.einsum("nij,ni->nj", frame, directions)


def facing(normal: Tensor, view: Tensor, least: float = 0.02) -> Tensor:
    """Smooth unit normals [n, 3], tilted until they face the eye.

    At a silhouette, interpolated normals may point away from the eye.
    """
    cosine = (normal * view).sum(-1, keepdim=True)
    return nn.functional.normalize(normal + (least - cosine).clamp_min(0) * view, dim=-1)
