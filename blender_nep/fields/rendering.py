"""Renders rays through both fields: the environment in front of the object, the object, the environment behind it.

The border between the fields is the unit sphere. A ray that misses the sphere is rendered by F_e alone.

F_o is in the object's frame, and F_e in the room's. On a turntable the object turns, so each photo has its own motion from
the one to the other (`RayBundle.in_room`). The sphere moves with the object, and distances along a ray stay the same.

If the object stands on a support plane, the part of the plane in the sphere is opaque. Its color comes from F_o's color
heads, as that of the object's surface. A ray that meets the plane before the sphere is rendered by F_e alone.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from blender_nep.capture.rays.ray_bundle import RayBundle
from blender_nep.fields.environment.field import EnvironmentField
from blender_nep.fields.object.field import Appearance, ObjectField, SplineShape
from blender_nep.presets import FieldsPreset
from blender_nep.profiling import profiled, section

_LEAST_OPACITY = 0.01
"""The object covers a ray from this opacity on. Rays that are there for the object alone count then."""


@dataclass(frozen=True)
class RenderSettings:
    """The settings of the rendering that the schedule changes."""

    sharpness: float
    """NeuS sharpness, 1 / object radius"""
    samples: int
    """Samples of the object field on each ray"""
    environment_gradient_scale: float = 1.0
    """Scale of F_e's gradients from rays that may show the object"""
    object_is_known: bool = False
    """Only rays that the object covers may show it. False: all that meet its sphere"""


@dataclass
class Rendering:
    """The result for n rays."""

    radiance: Tensor
    """[n, 3] linear"""
    opacity: Tensor
    """[n] opacity of the object, 0..1"""
    weight: Tensor
    """[n, 1] loss weight, the paper's w_l: w_s accumulated along the ray.
    It is 0 for rays for the object alone that the object hardly covers"""
    eikonal: Tensor
    """Scalar: mean of (|gradient of the SDF| - 1)^2 over all samples"""
    curvature: Tensor
    """Scalar: mean of sqrt(|Hessian of the SDF|^2 + 1) over surface points; 0 if the curvature loss has no weight"""
    foreground_opacity: Tensor
    """Scalar: mean opacity of F_e between the cameras and the object's sphere. Rays for the object alone count as 0"""
    distortion: Tensor
    """Scalar: mean distortion of F_e on the rays (`ops.environment.rendering`). It is 0 where F_e is not rendered"""


@dataclass(frozen=True)
class SphereHits:
    """The points at which n rays enter and leave the object's sphere, or the part of it above the support plane."""

    entry: Tensor
    """[n] distances along the rays"""
    leave: Tensor
    """[n] distances along the rays; equal to `entry` where a ray misses the sphere"""
    rays: Tensor
    """[m] int64: indices of the rays that meet the sphere"""
    on_support: Tensor
    """[n] bool: whether the rays leave through the support plane"""

    @classmethod
    def of(cls, rays: RayBundle, shape: SplineShape) -> SphereHits:
        """The hits of the rays with the unit sphere and the support plane."""
        entry, leave, on_support = shape.interval(rays.origins, rays.directions)
        return cls(entry, leave, (leave > entry).nonzero()[:, 0], on_support)


@dataclass(frozen=True)
class EnvironmentParts:
    """F_e's part of n rays: in front of the sphere, and behind the sphere for k of the rays."""

    front: Tensor
    """[n, 3] radiance in front of the sphere; of the whole ray if it misses the sphere; 0 of rays for the object alone"""
    transmittance: Tensor
    """[n] transmittance of F_e up to the sphere; 1 for rays for the object alone"""
    back: Tensor
    """[k, 3] radiance behind the sphere"""
    foreground_opacity: Tensor
    """Scalar, as in `Rendering`"""
    distortion: Tensor
    """Scalar, as in `Rendering`"""


def dynamic_weight(appearance: Appearance, cap: float, epsilon: float = 1e-3) -> Tensor:
    """The paper's w_s (eq. 4) [n, 1]. It is small where the color differs much from the albedo, as in reflections.

    w_s has no gradient; otherwise a growing |c_o - c_a| would lower the loss.

    cap: the paper's u. epsilon: the paper's "small value", which keeps the fraction finite.
    """
    square = ((appearance.color.detach() - appearance.albedo.detach()) ** 2).mean(-1, keepdim=True)
    return (1 / (square + epsilon)).clamp(max=cap)


@dataclass(frozen=True)
class FieldsRenderer:
    """Renders rays through an object field and the environment field around it."""

    object_field: ObjectField
    environment: EnvironmentField
    preset: FieldsPreset

    @profiled("render")
    def render(
        self, rays: RayBundle, settings: RenderSettings, generator: torch.Generator | None, clear_rays: int = 0
    ) -> Rendering:
        """Render rays, whether they meet the sphere or not. With a generator (for learning), samples are jittered.

        The first `clear_rays` rays are there for the object alone. F_e is known to be clear in front of them, and is not
        rendered there. Those that the object hardly covers get the weight 0, and nothing is rendered behind it.
        """
        p, n, device = self.preset, len(rays), rays.origins.device
        shape = self.object_field.shape()
        hits = SphereHits.of(rays, shape)
        meets = hits.rays
        surface = shape.render(rays.origins[meets], rays.directions[meets], settings.sharpness, settings.samples, generator)
        ray = meets[surface.ray]
        # 1e-6: if the samples' gradients cancel out, the mean gradient is 0
        normal = functional.normalize(surface.gradient, dim=-1, eps=1e-6)
        with section("appearance"):
            appearance = self.object_field.appearance(surface.point, normal, rays.directions[ray], rays.motion_of(ray))
        opacity = surface.opacity.clamp(max=1)
        clear = torch.ones(len(meets), device=device).index_add(0, surface.ray, -opacity)
        idle = torch.zeros(n, dtype=torch.bool, device=device)
        idle[:clear_rays] = True
        idle[meets] &= clear.detach() > 1 - _LEAST_OPACITY
        behind = ((clear.detach() > p.transmittance_limit) & ~idle[meets]).nonzero()[:, 0]
        on_support = hits.on_support[meets[behind]]
        below, behind = behind[on_support], behind[~on_support]
        of_object = meets[clear.detach() < 1 - _LEAST_OPACITY] if settings.object_is_known else meets
        parts = self._render_environment(rays, hits, meets[behind], of_object, settings, generator, clear_rays)
        inside = torch.zeros(len(meets), 3, device=device)
        inside = inside.index_add(0, surface.ray, opacity[:, None] * appearance.color)
        inside = inside.index_add(0, behind, clear[behind, None] * parts.back)
        if len(below):
            support = self._support_color(rays[meets[below]], hits.leave[meets[below]])
            inside = inside.index_add(0, below, clear[below, None] * support)
        radiance = parts.front.index_add(0, meets, parts.transmittance[meets, None] * inside)
        opacities = torch.zeros(n, device=device).index_add(0, ray, opacity)
        weight = (~idle).float()[:, None]
        if p.dynamic_weight and p.decomposition:
            w_s = dynamic_weight(appearance, p.dynamic_weight_cap)
            weight = weight.index_add(0, ray, (opacity.detach() * ~idle[ray])[:, None] * (w_s - 1))
        nothing = radiance.sum() * 0
        eikonal = surface.eikonal.mean() if len(ray) else nothing
        with section("curvature"):
            curvature = (shape.bending(surface.point) + 1).sqrt().mean() if len(ray) and p.curvature > 0 else nothing
        return Rendering(radiance, opacities, weight, eikonal, curvature, parts.foreground_opacity, parts.distortion)

    @torch.no_grad()
    def background(self, rays: RayBundle) -> Tensor:
        """The radiance [n, 3] that rays [n] would have without the object: that of F_e and of the support plane."""
        hits = SphereHits.of(rays, self.object_field.shape())
        near = torch.full_like(hits.entry, self.environment.preset.camera_near)
        end = torch.where(hits.on_support, hits.entry, torch.inf)
        origins, directions, half_angle = rays.in_room()
        radiance, transmittance, _ = self.environment.render(origins, directions, near, end, half_angle)
        below = hits.on_support.nonzero()[:, 0]
        if len(below):
            radiance[below] += transmittance[below, None] * self._support_color(rays[below], hits.leave[below])
        return radiance

    def _support_color(self, rays: RayBundle, distance: Tensor) -> Tensor:
        """Radiance [n, 3] of the support plane that rays [n] meet at distances [n]."""
        assert self.object_field.support is not None, "a ray has met the support plane"
        point = rays.origins + distance[:, None] * rays.directions
        normal = torch.as_tensor(self.object_field.support.normal, dtype=point.dtype, device=point.device)
        return self.object_field.appearance(point, normal.expand_as(point), rays.directions, rays.motion).color

    def front(self, shape: SplineShape) -> Callable[[RayBundle], Tensor]:
        """A function of n rays that meet the sphere. It gives the transmittance [n] of F_e in front of the sphere, or in
        front of the support plane of `shape`."""

        def transmittance(rays: RayBundle) -> Tensor:
            entry = shape.interval(rays.origins, rays.directions)[0]
            near = torch.full_like(entry, self.environment.preset.camera_near)
            room = rays.in_room()
            with torch.no_grad():
                return self.environment.render(room.origins, room.directions, near, entry).transmittance

        return transmittance

    def _render_environment(
        self,
        rays: RayBundle,
        hits: SphereHits,
        behind: Tensor,
        of_object: Tensor,
        settings: RenderSettings,
        generator: torch.Generator | None,
        clear_rays: int,
    ) -> EnvironmentParts:
        """Render F_e in front of the sphere for all rays but the clear ones, and behind it for the rays `behind` [k] int64.

        One call of the kernel renders both. The rays `of_object` [m] int64 may show the object.
        """
        n, device = len(rays), rays.origins.device
        front = torch.arange(clear_rays, n, device=device)
        near = torch.full_like(hits.entry, self.environment.preset.camera_near)
        infinity = torch.full_like(hits.entry, torch.inf)
        index = torch.cat([front, behind])
        part = rays[index].in_room()
        start = torch.cat([near[front], hits.leave[behind]])
        end = torch.cat([torch.where(hits.leave > hits.entry, hits.entry, infinity)[front], infinity[behind]])
        radiance, transmittance, distortion = self.environment.render(
            part.origins, part.directions, start, end, part.half_angle, generator
        )
        k, everywhere = len(front), torch.ones(n, device=device)
        passed = everywhere.index_copy(0, front, transmittance[:k])
        foreground_opacity = (1 - passed[hits.rays]).mean() if len(hits.rays) else radiance.sum() * 0
        if settings.environment_gradient_scale != 1:
            # F_e shall follow the pixels beside the object, and not change so that the object's error becomes small
            scale = everywhere.index_fill(0, of_object, settings.environment_gradient_scale)[index]
            radiance = torch.lerp(radiance.detach(), radiance, scale[:, None])
            passed = everywhere.index_copy(0, front, torch.lerp(transmittance.detach(), transmittance, scale)[:k])
        before = torch.zeros(n, 3, device=device).index_copy(0, front, radiance[:k])
        return EnvironmentParts(before, passed, radiance[k:], foreground_opacity, distortion.sum() / max(n, 1))
