"""The prefiltered incoming light of surface points at several roughness levels.

The mesh and F_e do not change while materials are learned. So the light through the GGX lobe of each roughness level, and
the diffuse irradiance, are gathered once by cones. A pixel blurs the reflection that it shows. So the specular cones are
wider by the variance of the mirrored direction within the pixel. Between the levels, the light is interpolated. Only cones
that meet the object again depend on the materials. They are kept in a list, and their light is updated from time to time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from blender_nep.capture.rays.rigid_motions import RigidMotions
from blender_nep.ops.materials.lobe_sums import add_to_lobes
from blender_nep.profiling import profiled
from blender_nep.shading import brdf
from blender_nep.shading.cones import diffuse_cones, half_angle_of_density, specular_cones
from blender_nep.shading.light_moments import LightMoments
from blender_nep.shading.photographer import STRENGTHS, at_strength, shadow
from blender_nep.shading.plenoptic import (
    Material,
    PlenopticFunction,
    SpecularMoments,
    SurfacePoints,
    affine_in_albedo,
    moment_weights,
)
from blender_nep.shading.smooth_irradiance import IrradianceMean
from blender_nep.shading.unseen_light import UncoveredCones, UnseenLight

_FULL, _EDGE, _DIELECTRIC = range(3)

_CHUNK = 1 << 17
"""Number of cones that are traced at a time."""
_UNSEEN_CHUNK = 1 << 16
"""Number of cones that are looked up in the unseen light at a time."""
_LEAST_SHARE = 0.02
"""Cones whose missing coverage is at most this share are not kept as uncovered cones."""


@dataclass
class TracedLight:
    """The trace result of the cones of n surface points. It does not depend on the materials."""

    specular: Tensor
    """[n, R, 3, 3] light of F_e, as far as it counts, through the specular lobe of R roughness levels: three moments with
    three colors each"""
    diffuse: Tensor
    """[n, 3] irradiance from F_e, as far as it counts, divided by pi"""
    coverage: Tensor
    """[n, R] in 0..1: share of the specular lobe whose light the photos show"""
    shadow: Tensor
    """[n, 1 + R, S] how much darker a photographer makes even light in the diffuse lobe and in that of each level, at the
    strengths `photographer.STRENGTHS`, as natural logarithms >= 0; 0 if the object turned"""
    hit_index: Tensor
    """[h] int64: index of the surface point, for each cone that met the mesh again"""
    hit_weight: Tensor
    """[h, 1 + R, 3] weights of these cones: in the diffuse lobe (three equal numbers), and in the moments of each level"""
    hits: SurfacePoints
    """[h] points at which these cones met the mesh"""
    uncovered: UncoveredCones
    """The cones that left the object in directions that the photos do not show well"""
    rays: int
    """Number of cones that were traced"""

    _TENSORS = ("coverage", "shadow", "hit_index", "hit_weight")

    def state(self) -> dict:
        """The trace result as a dict of tensors and numbers, for a checkpoint."""
        hits = {
            "position": self.hits.position,
            "face": torch.from_numpy(self.hits.face.astype(np.int64)),
            "normal": self.hits.normal,
            "view": self.hits.view,
            "motion": None if self.hits.motion is None else vars(self.hits.motion),
        }
        own = {name: getattr(self, name) for name in self._TENSORS}
        direct = {"direct_specular": self.specular, "direct_diffuse": self.diffuse}
        return {"rays": self.rays, "hits": hits, "uncovered": vars(self.uncovered), **direct, **own}

    @classmethod
    def joined(cls, parts: Sequence[TracedLight]) -> TracedLight:
        """All parts, one after the other. `hit_index` and `uncovered.row` must already count the points of all parts."""

        def cat(name: str) -> Tensor:
            return torch.cat([getattr(part, name) for part in parts])

        return cls(
            specular=cat("specular"),
            diffuse=cat("diffuse"),
            **{name: cat(name) for name in cls._TENSORS},
            hits=SurfacePoints.joined([part.hits for part in parts]),
            uncovered=UncoveredCones.joined([part.uncovered for part in parts]),
            rays=sum(part.rays for part in parts),
        )

    @classmethod
    def from_state(cls, state: dict, device: torch.device) -> TracedLight:
        """The inverse of `state`."""
        hits, motion = state["hits"], state["hits"]["motion"]
        return cls(
            specular=state["direct_specular"].to(device),
            diffuse=state["direct_diffuse"].to(device),
            **{name: state[name].to(device) for name in cls._TENSORS},
            hits=SurfacePoints(
                hits["position"].to(device),
                hits["face"].cpu().numpy(),
                hits["normal"].to(device),
                hits["view"].to(device),
                None if motion is None else RigidMotions(**{name: part.to(device) for name, part in motion.items()}),
            ),
            uncovered=UncoveredCones(**{name: value.to(device) for name, value in state["uncovered"].items()}),
            rays=state["rays"],
        )


@dataclass(frozen=True, eq=False)
class IncomingLight(LightMoments):
    """Light moments of n surface points at R roughness levels, and their diffuse irradiance: the known and the unseen light.

    `specular` and `diffuse` are the whole light. It does not change: `updated` and `with_unseen` return a new one, which
    shares with this one what stays the same.
    """

    plenoptic: PlenopticFunction
    """f_p with the same unseen light"""
    points: SurfacePoints
    """[n]"""
    traced: TracedLight
    """The trace result of the cones of the points"""
    known_specular: Tensor
    """[n, R, 3, 3] `specular` without the unseen light: the light of F_e and, from the first `updated` on, the light that
    the object reflects to itself"""
    known_diffuse: Tensor
    """[n, 3] the same of `diffuse`. It is a mean over neighboring points"""
    mean: IrradianceMean
    """Takes that mean"""
    photographer: float = 0.0
    """Strength of the photographer who takes light away. What the object reflects to itself stays as it is. What is taken
    from the irradiance is a mean over neighboring points of all photos (docs/lab/photographer.md)"""

    @classmethod
    def of(
        cls, plenoptic: PlenopticFunction, points: SurfacePoints, roughness_levels: tuple[float, ...], traced: TracedLight
    ) -> IncomingLight:
        """The light of F_e alone at n surface points; `traced` is the trace result of their cones (`gathered` computes it).

        Raises ValueError if f_p has an unseen light: `with_unseen` adds it.
        """
        if plenoptic.unseen is not None:
            raise ValueError("the unseen light is added by `with_unseen`")
        mean = IrradianceMean.over(points)
        known = traced.specular, mean(traced.diffuse)
        levels = torch.tensor(roughness_levels, device=points.position.device)
        cos_v = (points.normal * points.view).sum(-1)
        return cls(*known, traced.coverage, cos_v, levels, plenoptic, points, traced, *known, mean)

    @property
    def unseen(self) -> UnseenLight | None:
        """The light that no photo shows. None: there is none."""
        return self.plenoptic.unseen

    @classmethod
    @profiled("gather light")
    def gathered(
        cls,
        plenoptic: PlenopticFunction,
        points: SurfacePoints,
        roughness_levels: tuple[float, ...],
        irradiance: int,
        reflection_variance: Tensor,
        generator: torch.Generator,
        progress: Callable[[float], None],
        up: Tensor | None = None,
    ) -> IncomingLight:
        """Trace every cone once; a point has `irradiance` cones for the diffuse lobe.

        reflection_variance [n] radians^2 is that of the mirrored direction within the pixel that shows the point. It
        widens the specular cones. progress(share that is done, 0..1) is called after each chunk. `up` [3] tells where the
        photographer stands; None: that is not known.
        """
        device, n = points.position.device, len(points)
        levels = torch.tensor(roughness_levels, device=device)
        cones = irradiance + len(levels) * plenoptic.settings.specular
        parts = []
        for rows in torch.arange(n, device=device).split(max(1, _CHUNK // cones)):
            own = points[rows], reflection_variance[rows]
            parts.append(_trace(plenoptic, *own, int(rows[0]), levels, irradiance, generator, up))
            progress((int(rows[-1]) + 1) / n)
        return cls.of(plenoptic, points, roughness_levels, TracedLight.joined(parts))

    @profiled("self reflection")
    def updated(
        self,
        materials_at: Callable[[SurfacePoints], Material],
        generator: torch.Generator,
        unseen: UnseenLight | None = None,
    ) -> IncomingLight:
        """The light under the present materials: the light that the object reflects to itself is another.

        `unseen` takes the place of the present unseen light, unless it is None.
        """
        traced, unseen = self.traced, self.unseen if unseen is None else unseen
        specular, diffuse = traced.specular.clone(), traced.diffuse.clone()
        if self.photographer:
            specular, diffuse = specular * self.left()[:, 1:, None, None], torch.zeros_like(diffuse)
        if len(traced.hit_index) and self.plenoptic.settings.levels > 0:
            light = replace(self.plenoptic, unseen=unseen).outgoing(traced.hits, materials_at, 2, generator)
            for part in torch.arange(len(light), device=light.device).split(1 << 15):
                share = traced.hit_weight[part, ..., None] * light[part, None, None, :]
                diffuse.index_add_(0, traced.hit_index[part], share[:, 0, 0])
                specular.index_add_(0, traced.hit_index[part], share[:, 1:])
        mean = self.mean(diffuse)
        if self.photographer:
            mean = mean + self.mean(traced.diffuse * self.left()[:, :1])
        return replace(self, known_specular=specular, known_diffuse=mean).with_unseen(unseen)

    @profiled("add the unseen light")
    def with_unseen(self, unseen: UnseenLight | None) -> IncomingLight:
        """The known light plus this unseen light."""
        plenoptic = replace(self.plenoptic, unseen=unseen)
        if unseen is None:
            return replace(self, plenoptic=plenoptic, specular=self.known_specular, diffuse=self.known_diffuse)
        far, position = self.traced.uncovered, self.points.room_position
        parts = torch.arange(len(far), device=position.device).split(_UNSEEN_CHUNK)
        light = torch.cat([_unseen_light(unseen, position, far[part]) for part in parts])
        # `row` is ascending, so the cones of a point lie together.
        starts = torch.searchsorted(far.row, torch.arange(len(position) + 1, device=far.row.device))
        specular, diffuse = self.known_specular.cpu().numpy().copy(), self.known_diffuse.cpu().numpy().copy()
        weight = far.weight * self.left()[far.row] if self.photographer else far.weight
        starts, weight, fresnel, light = (x.contiguous().cpu() for x in (starts, weight, far.fresnel, light))
        add_to_lobes(starts.numpy(), weight.numpy(), fresnel.numpy(), light.numpy(), diffuse, specular)
        whole = [torch.from_numpy(x).to(position.device) for x in (specular, diffuse)]
        return replace(self, plenoptic=plenoptic, specular=whole[0], diffuse=whole[1])

    def left(self, more: float = 0.0) -> Tensor:
        """The share [n, 1 + R] of even light that the photographer leaves in each lobe, if stronger by `more`."""
        return torch.exp(-at_strength(self.traced.shadow, self.photographer + more))

    def behind(self, more: float) -> IncomingLight:
        """The light behind a photographer who is stronger by `more`."""
        change = self.left(more) - self.left()
        specular = self.known_specular + self.traced.specular * change[:, 1:, None, None]
        diffuse = self.known_diffuse + self.mean(self.traced.diffuse * change[:, :1])
        lit = replace(self, known_specular=specular, known_diffuse=diffuse, photographer=self.photographer + more)
        return lit.with_unseen(self.unseen)

    def moments_behind(self, more: float, rows: Tensor) -> LightMoments:
        """About the same at the points `rows` [m]: what the object reflects to itself is taken away, too."""
        left = (self.left(more) / self.left())[rows]
        return LightMoments(
            self.specular[rows] * left[:, 1:, None, None],
            self.diffuse[rows] * left[:, :1],
            self.coverage[rows],
            self.cos_v[rows],
            self.roughness_levels,
        )

    def without_unseen(self) -> LightMoments:
        """The known light alone."""
        return LightMoments(self.known_specular, self.known_diffuse, self.coverage, self.cos_v, self.roughness_levels)

    def uncovered_cones(self, rows: Tensor) -> UncoveredCones:
        """The uncovered cones of the points `rows` [m] int64. Their `row` counts these points: 0..m-1."""
        place = torch.full((len(self.points),), -1, device=rows.device)
        place[rows] = torch.arange(len(rows), device=rows.device)
        cones = self.traced.uncovered
        cones = cones[(place[cones.row] >= 0).nonzero().squeeze(-1)]
        if self.photographer:
            cones = replace(cones, weight=cones.weight * self.left()[cones.row])
        return replace(cones, row=place[cones.row])

    def uncovered_response(self, cones: UncoveredCones, rows: Tensor, material: Material) -> tuple[Tensor, Tensor]:
        """Radiance that a point sends to the eye for a radiance of 1 in one of its uncovered cones.

        `rows` [m] are the points, `material` holds their m materials, `cones` are their k uncovered cones. Returns offset
        and slope [k, 3] of `affine_in_albedo`.
        """
        each, row = torch.arange(len(cones), device=rows.device), cones.row
        own = Material(material.albedo[row], material.roughness[row], material.metallic[row])
        low, mix = self.roughness_interval(own.roughness)
        full = torch.lerp(cones.weight[each, 1 + low], cones.weight[each, 2 + low], mix)[:, None]
        moments = SpecularMoments(full, full * cones.fresnel[:, :1], full * cones.fresnel[:, 1:])
        return affine_in_albedo(own, moments, cones.weight[:, :1], self.cos_v[rows][row])

    def known_moments(self, roughness: Tensor, rows: Tensor | slice = slice(None)) -> SpecularMoments:
        """`moments` without the unseen light."""
        return self.between_levels(self.known_specular, roughness, rows)


def _unseen_light(unseen: UnseenLight, position: Tensor, cones: UncoveredCones) -> Tensor:
    """The unseen light [k, 3] in k cones, times the share of each cone that the photos do not show.

    position [n, 3] are those of the points in the room's frame.
    """
    return unseen(position[cones.row], cones.direction, cones.half_angle) * cones.share[:, None]


def _trace(
    plenoptic: PlenopticFunction,
    points: SurfacePoints,
    reflection_variance: Tensor,
    first: int,
    roughness_levels: Tensor,
    irradiance: int,
    generator: torch.Generator,
    up: Tensor | None,
) -> TracedLight:
    """Trace the cones of some points. Among all points, these are numbers `first`, `first` + 1, and so on."""
    n, device = len(points), points.position.device
    frame = brdf.frame(points.normal)
    v = torch.einsum("nij,ni->nj", frame, points.view)
    direction, angle, weight = lobe_cones(v, roughness_levels, irradiance, plenoptic.settings.specular, generator)
    # A disc of half angle a has the variance a^2 / 4 along each axis.
    angle[:, irradiance:] = (angle[:, irradiance:] ** 2 + 4 * reflection_variance[:, None]).sqrt()
    # A cone of no weight (below the horizon) need not be traced.
    live = (weight[..., _FULL].amax(-1) > 0).reshape(-1).nonzero().squeeze(-1)
    each = live // direction.shape[1]
    direction = torch.einsum("nij,nj->ni", frame[each], direction.reshape(-1, 3)[live])
    weight = weight.flatten(0, 1)[live]
    angle = angle.reshape(-1)[live]
    traced = plenoptic.trace(points[each], direction, angle)

    def gather(values: Tensor) -> Tensor:
        return torch.zeros(n, *values.shape[1:], device=device).index_add_(0, each, values)

    total = gather(weight[..., None] * traced.radiance[:, None, None, :])
    dark = torch.zeros_like(traced.coverage) if up is None else shadow(direction, points.view[each], up)
    lobes = gather(weight[..., _FULL]).clamp_min(1e-9)
    seen = gather(weight[:, 1:, 0] * traced.coverage[:, None])
    far = (traced.coverage < 1 - _LEAST_SHARE).nonzero().squeeze(-1)
    full = weight[far, 1:, _FULL]
    level = full.argmax(1)
    terms = weight[far, 1 + level][:, [_EDGE, _DIELECTRIC]] / full.gather(1, level[:, None]).clamp_min(1e-12)
    return TracedLight(
        specular=total[:, 1:],
        diffuse=total[:, 0, 0],
        coverage=seen / gather(weight[:, 1:, 0]).clamp_min(1e-9),
        shadow=torch.stack([_shadow(gather, weight[..., _FULL], k * dark, lobes) for k in STRENGTHS], -1),
        hit_index=first + each[traced.row],
        hit_weight=weight[traced.row],
        hits=traced.hits,
        uncovered=UncoveredCones(
            first + each[far],
            points[each[far]].in_room(direction[far]),
            angle[far],
            1 - traced.coverage[far],
            weight[far, :, _FULL],
            terms,
        ),
        rays=len(live),
    )


def _shadow(gather: Callable[[Tensor], Tensor], weight: Tensor, dark: Tensor, lobes: Tensor) -> Tensor:
    """How much darker [n, 1 + R] lobes are if their cones are darker by `dark` [k]. weight [k, 1 + R]; lobes: its sums."""
    left = gather(weight * torch.exp(-dark)[:, None]) / lobes
    return torch.where(lobes > 1e-8, -left.clamp(1e-3, 1).log(), 0.0)


def lobe_cones(
    v: Tensor, roughness_levels: Tensor, irradiance: int, specular: int, generator: torch.Generator
) -> tuple[Tensor, Tensor, Tensor]:
    """Cones for local views v [n, 3]: `irradiance` for the diffuse lobe, and `specular` for each of R roughness levels.

    The samples of all levels are used for every level, by the balance heuristic (Veach 1995).

    Returns local directions [n, C, 3], half-angles [n, C] and weights [n, C, 1 + R, 3]: in the diffuse lobe (three equal
    numbers), and in the three moments of each level. The weights of a lobe are scaled so that they add up to its exact
    albedo; so a white furnace is exact. The width of a specular cone follows from the density of all samples around it.
    """
    n, levels = len(v), len(roughness_levels)
    turn = torch.rand(n, levels + 1, 2, generator=generator).to(v.device)
    diffuse, diffuse_angle = diffuse_cones(irradiance, turn[:, 0])
    direction = specular_cones(v[:, None].expand(n, levels, 3), roughness_levels.expand(n, levels), specular, turn[:, 1:])[0]
    direction = direction.reshape(n, -1, 3)
    cos_v, cos_l = v[:, None, 2], direction[..., 2]
    h = torch.nn.functional.normalize(v[:, None] + direction, dim=-1)
    cos_h, cos_vh = h[..., 2].clamp(0, 1), (v[:, None] * h).sum(-1)
    density, lobes = torch.zeros_like(cos_l), []
    for roughness in roughness_levels:
        alpha = brdf.alpha_of(roughness)
        density = density + specular * brdf.vndf_pdf(cos_v, cos_h, alpha)
        lobes.append(brdf.specular(cos_v.expand_as(cos_l), cos_l, cos_h, alpha) * cos_l.clamp_min(0))
    density = density.clamp_min(1e-9)
    weight = torch.stack(lobes, -1) / density[..., None] * (cos_l > 0)[..., None]
    albedo = brdf.specular_albedo(cos_v, roughness_levels)
    weight = weight * (albedo / weight.sum(1).clamp_min(1e-6))[:, None].clamp_max(1e3)
    fresnel = torch.stack(moment_weights(torch.ones_like(cos_vh), cos_vh), -1)
    whole = weight.new_zeros(n, irradiance + weight.shape[1], 1 + levels, 3)
    whole[:, :irradiance, 0] = 1 / max(irradiance, 1)
    whole[:, irradiance:, 1:] = weight[..., None] * fresnel[:, :, None]
    return torch.cat([diffuse, direction], 1), torch.cat([diffuse_angle, half_angle_of_density(density)], 1), whole
