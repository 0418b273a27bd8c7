"""Analyzes the mesh: whether the object sees itself, whether it is glossy, and which parts of stage 2 it does not need."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import torch

from blender_nep.evidence.agreement import variation
from blender_nep.evidence.full_photos import FullPhotos, Sampling
from blender_nep.evidence.observation import observe
from blender_nep.evidence.occluders import MeshOccluder
from blender_nep.geometry.ray_tracing import RayTracer
from blender_nep.messages import Message, Part
from blender_nep.scene.analysis import Analysis, Plan, percent

if TYPE_CHECKING:
    from blender_nep.capture import PixelRays
    from blender_nep.geometry.mesh import Surface
    from blender_nep.presets import Preset

HARDLY_SEES_ITSELF = 0.01
"""Self-visibility under which the object's reflections of itself are smaller than the error of the learned light."""
SECOND_BOUNCE = 0.1
"""Self-visibility from which on light is followed for a second bounce. That light is less than the square of the
self-visibility. Measured: no difference up to 0.08; at 0.14, the roughness of a glaze came out lower without the second
bounce in two of three seeds."""
MATTE = 0.08
"""View dependence under which the photos show no reflections. Measured: 0.035 for chalk, 0.32 for a glaze, 1.5 to 2.3 for
metals."""
GLOSSY = 0.25
"""View dependence from which on the object is called glossy."""
MATTE_FROM = 0.28
"""Lowest roughness level at which the light of a matte object is gathered."""


@dataclass(frozen=True)
class SurfaceAnalysis(Analysis):
    """Facts about the object that need the mesh."""

    self_visibility: float
    """Share of cosine-weighted directions from the surface that meet the surface again: 0 for a convex body"""
    view_dependence: float | None
    """How much the brightness of the same surface point differs from photo to photo: standard deviation divided by mean. Of
    all points it is the 90 % quantile, because only few points show highlights. Near 0 for chalk, large for mirrors. None if
    too few points are seen often enough"""

    @classmethod
    def of(cls, surface: Surface, rays: PixelRays, seed: int = 0) -> SurfaceAnalysis:
        """Analyze the mesh with about 100,000 rays. Takes half a second."""
        rng = np.random.default_rng(seed)
        tracer = RayTracer(surface.vertices, surface.faces)
        return cls(self_visibility(tracer, rng), view_dependence(tracer, surface.normals, rays, rng))

    def sentences(self) -> list[Message]:
        """Sentences on the object that an artist wants to know."""
        if self.convex:
            lines = [Message("scene.convex")]
        elif self.self_visibility < SECOND_BOUNCE:
            lines = [Message("scene.reflects_little_in_itself", {"percent": percent(self.self_visibility)})]
        else:
            lines = [Message("scene.reflects_in_itself", {"percent": percent(self.self_visibility)})]
        if self.matte:
            lines.append(Message("scene.matte"))
        elif self.view_dependence is not None:
            glossy = self.view_dependence >= GLOSSY
            lines.append(Message("scene.glossy") if glossy else Message("scene.hardly_glossy"))
        return lines

    @property
    def convex(self) -> bool:
        """Whether less than one ray in 1000 from the surface meets the surface again."""
        return self.self_visibility < 0.001

    @property
    def matte(self) -> bool:
        """Whether the photos show hardly any reflections."""
        return self.view_dependence is not None and self.view_dependence < MATTE

    def plan(self, preset: Preset) -> Plan:
        """The preset without the parts of material learning that this object does not need."""
        p = preset.material
        skipped: dict[str, Message] = {}
        if not preset.skip_needless:
            return Plan(preset, skipped)
        why = Message("reason.convex") if self.convex else Message("reason.reflects_little_in_itself")
        if p.levels > 0 and self.self_visibility < HARDLY_SEES_ITSELF:
            p = replace(p, levels=0)
            skipped[Part.INDIRECT_LIGHT] = why
        elif p.levels > 1 and self.self_visibility < SECOND_BOUNCE:
            p = replace(p, levels=1)
            skipped[Part.SECOND_BOUNCES] = why
        if self.matte:
            kept = tuple(r for r in p.roughness_levels if r >= MATTE_FROM)
            if 2 <= len(kept) < len(p.roughness_levels):
                p = replace(p, roughness_levels=kept, least_roughness=max(p.least_roughness, kept[0]))
                skipped[Part.NARROW_CONES] = Message("reason.matte")
        return Plan(replace(preset, material=p), skipped)


def self_visibility(tracer: RayTracer, rng: np.random.Generator, points: int = 4000, directions: int = 8) -> float:
    """Share of cosine-weighted rays that meet the mesh again. They start at points spread evenly over the mesh."""
    face, barycentric = _spread(tracer, points, rng)
    face, barycentric = face.repeat(directions), barycentric.repeat(directions, 0)
    normal = tracer.face_normals[face]
    # A point on the unit sphere around the tip of the normal gives a cosine-weighted direction (Malley's method).
    d = rng.normal(size=normal.shape)
    d = normal + d / np.linalg.norm(d, axis=1, keepdims=True)
    d = (d / np.maximum(np.linalg.norm(d, axis=1, keepdims=True), 1e-6)).astype(np.float32)
    start = tracer.leave(tracer.interpolate(tracer.vertices, face, barycentric), face, d)
    return float(tracer.occluded(start, d).mean())


def view_dependence(
    tracer: RayTracer,
    normals: np.ndarray,
    rays: PixelRays,
    rng: np.random.Generator,
    points: int = 1500,
    least_views: int = 4,
    least_cosine: float = 0.4,
) -> float | None:
    """How much the brightness of surface points varies over the photos that see them (`SurfaceAnalysis.view_dependence`).

    A photo sees a point if nothing hides it, and if the cosine between normal and view is above `least_cosine`. At smaller
    ones, even a dull surface reflects much, and a pixel spans a wide place. Points that fewer than `least_views` photos see
    are left out. None if less than a tenth of the points are left.
    """
    face, barycentric = _spread(tracer, points, rng)
    place = torch.from_numpy(tracer.interpolate(tracer.vertices, face, barycentric).astype(np.float32))
    normal = torch.from_numpy(tracer.smooth_normals(normals, face, barycentric))
    device, occluder = rays.radiance.device, MeshOccluder(tracer, faces=face)
    photos = FullPhotos(rays, Sampling.PIXEL)  # interpolated pixels would vary less
    seen = observe(photos, place.to(device), normal.to(device), occluder, least_cosine=least_cosine)
    varies, views = variation(seen, points)
    often = views >= least_views
    if often.sum() < 0.1 * points:
        return None
    return float(np.quantile(varies[often], 0.9))


def _spread(tracer: RayTracer, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Faces [count] and barycentric coordinates [count, 3] of points spread evenly over the mesh."""
    corner = tracer.vertices[tracer.faces].astype(np.float64)
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    face = rng.choice(len(area), count, p=area / area.sum())
    u = np.sqrt(rng.random(count))
    v = rng.random(count)
    return face, np.stack([1 - u, u * (1 - v), u * v], 1)
