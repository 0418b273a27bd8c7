"""What a capture needs: what is in the photos, said in plain words before anything is learned, and what can be left out.

Two looks, both pure and cheap: one at the photos (`SceneAnalysis.of`), one at the mesh once there is one
(`SurfaceAnalysis.of`). Each gives facts with numbers, sentences about them, and a preset without the parts that this scene
does not need. `Preset.skip_needless` turns the leaving out off; the sentences stay.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import torch

from blender_nep.capture.exposure import stops
from blender_nep.capture.pixel_rays import BRIGHTEST_CLIPPED, SATURATED, pixel_width
from blender_nep.geometry.ray_tracing import RayTracer
from blender_nep.messages import Message, Part

if TYPE_CHECKING:
    from blender_nep.capture import PixelRays
    from blender_nep.geometry.mesh import Surface
    from blender_nep.presets import MaterialPreset, Preset

HARDLY_SEES_ITSELF = 0.01
"""Self-visibility under which what the object reflects of itself is less than what its light is known to."""
SECOND_BOUNCE = 0.1
"""Self-visibility from which on light is followed for a second bounce: less than its square comes that way. Measured: no
difference up to 0.08; at 0.14 the roughness of a glaze came out lower without it in two of three seeds."""
MATTE = 0.08
"""View dependence under which the photos show no reflections. Measured: 0.035 for chalk, 0.32 for a glaze, 1.5 to 2.3 for
metals."""
GLOSSY = 0.25
"""View dependence from which on the object is called glossy."""
MATTE_FROM = 0.28
"""Roughness from which on a matte object's light is gathered."""
_CAST = 0.05
"""Difference of logarithms of the channels that an artist would call a cast of color."""
_PIXELS = 300_000
"""Pixels looked at, of all photos."""


@dataclass(frozen=True)
class Plan:
    """The preset for this scene, and {what is left out: why}."""

    preset: Preset
    skipped: dict[str, Message]


@dataclass(frozen=True)
class SceneAnalysis:
    """Facts of the photos, as far as they are learned from (box-filtered to the preset's size)."""

    photos: int
    masks: bool
    """The object's masks are there and used"""
    backdrop: bool
    """False: the photos are cut-outs, nothing is known of the surroundings"""
    brightest: float
    """Largest radiance, linear; about 1 where the files cannot hold more"""
    clipped: float
    """Share of the object's pixels (without masks: its sphere's) that stand at the top of the files' range"""
    sphere_share: float
    """Share of the photos' pixels that look at the object's sphere"""
    object_share: float | None
    """Share of those that show the object; None without masks"""
    pixels_across: float
    """Pixels across the sphere, median of the views"""
    exposure_stops: float
    """Between the darkest and the brightest exposure of a photo; 0 where all share one, or where it cannot be told"""
    white_balance: float
    """Standard deviation of the channels' gains, logarithms, from their mean; 0 where all photos share one white balance"""

    @classmethod
    def of(cls, rays: PixelRays) -> SceneAnalysis:
        """Looks at some 300,000 pixels; takes a tenth of a second."""
        some = rays.sphere[:: max(1, len(rays.sphere) // _PIXELS)]
        shown = None if rays.mask is None else rays.mask[some] > 127
        radiance = rays.radiance[some].float().amax(-1)
        if shown is not None and shown.any():
            radiance = radiance[shown]
        brightest = rays.brightest
        if brightest <= BRIGHTEST_CLIPPED:
            clipped = int((radiance > SATURATED).sum())
        else:  # a file of a larger range that was clipped has many pixels at one and the same top, not one
            clipped = max(int((radiance >= 0.999 * brightest).sum()) - 1, 0)
        origins, _, angle = rays.rays(some[:: max(1, len(some) // 5000)])
        return cls(
            photos=rays.views,
            masks=rays.mask is not None,
            backdrop=rays.background,
            brightest=brightest,
            clipped=clipped / max(len(radiance), 1),
            sphere_share=len(rays.sphere) / max(int(rays.valid.sum()), 1),
            object_share=None if shown is None else float(shown.float().mean()),
            pixels_across=2 / max(float((pixel_width(angle) * origins.norm(dim=-1)).median()), 1e-9),
            exposure_stops=0.0 if rays.gain is None else float(np.ptp(stops(rays.gain))),
            white_balance=0.0 if rays.gain is None else float(_color(rays.gain).square().mean().sqrt()),
        )

    def facts(self) -> dict:
        """As plain values, for the report."""
        return _rounded(asdict(self))

    def sentences(self) -> list[Message]:
        """What an artist would want to know."""
        if self.backdrop:
            lines = [Message("scene.surroundings", {"photos": self.photos})]
        else:
            lines = [Message("scene.cut_outs", {"photos": self.photos})]
        lines.append(Message("scene.masks_used") if self.masks else Message("scene.masks_not_used"))
        lines.append(self._range())
        exposure, white_balance = self.exposure_stops >= 0.1, self.white_balance > _CAST
        if exposure and white_balance:
            lines.append(Message("scene.exposure_and_white_balance_differ", {"stops": self.exposure_stops}))
        elif exposure:
            lines.append(Message("scene.exposure_differs", {"stops": self.exposure_stops}))
        elif white_balance:
            lines.append(Message("scene.white_balance_differs"))
        return [*lines, self._size()]

    def _range(self) -> Message:
        """Whether highlights are clipped."""
        if self.clipped >= 0.001 and self.masks:
            return Message("scene.object_clipped", {"percent": _percent(self.clipped)})
        if self.clipped >= 0.001:
            return Message("scene.sphere_clipped", {"percent": _percent(self.clipped)})
        return Message("scene.high_range") if self.brightest > BRIGHTEST_CLIPPED else Message("scene.hardly_clipped")

    def _size(self) -> Message:
        """How much of the photos the sphere, and the object in it, takes."""
        pixels, percent = self.pixels_across, _percent(self.sphere_share)
        if self.object_share is None:
            return Message("scene.sphere_size", {"pixels": pixels, "percent": percent})
        object_percent = _percent(self.object_share)
        return Message("scene.object_size", {"pixels": pixels, "percent": percent, "object_percent": object_percent})

    def plan(self, preset: Preset) -> Plan:
        """Stage 1 and what holds for both stages."""
        skipped: dict[str, Message] = {}
        if not preset.skip_needless:
            return Plan(preset, skipped)
        if not self.backdrop:
            preset = replace(preset, environment=replace(preset.environment, model="none"))
            skipped[Part.ENVIRONMENT_FIELD] = Message("reason.cut_outs")
        if preset.material.metallic == (1.0,):
            preset = replace(preset, material=replace(preset.material, irradiance_cones=0, diffuse_cones=0))
            skipped[Part.IRRADIANCE] = Message("reason.metal")
        return Plan(preset, skipped)


def _color(gain: torch.Tensor) -> torch.Tensor:
    """What gains [views, 3] change besides the exposure, as logarithms."""
    return gain.log() - gain.log().mean(1, keepdim=True)


@dataclass(frozen=True)
class SurfaceAnalysis:
    """Facts that need the mesh."""

    self_visibility: float
    """Share of the directions, weighted by their cosine, in which the surface meets itself: 0 for a convex body"""
    view_dependence: float | None
    """How much the same place differs from photo to photo (standard deviation over mean; of the places, the 90 % quantile,
    because highlights lie on few of them): near 0 for chalk, large for mirrors; None where too few places are seen often"""

    @classmethod
    def of(cls, surface: Surface, rays: PixelRays, seed: int = 0) -> SurfaceAnalysis:
        """Casts some 100,000 rays; takes half a second."""
        rng = np.random.default_rng(seed)
        tracer = RayTracer(surface.vertices, surface.faces)
        return cls(self_visibility(tracer, rng), view_dependence(tracer, surface.normals, rays, rng))

    def facts(self) -> dict:
        """As plain values, for the report."""
        return _rounded(asdict(self))

    def sentences(self) -> list[Message]:
        """What an artist would want to know."""
        percent = _percent(self.self_visibility)
        if self.convex:
            lines = [Message("scene.convex")]
        elif self.self_visibility < SECOND_BOUNCE:
            lines = [Message("scene.reflects_little_in_itself", {"percent": percent})]
        else:
            lines = [Message("scene.reflects_in_itself", {"percent": percent})]
        if self.matte:
            lines.append(Message("scene.matte"))
        elif self.view_dependence is not None:
            glossy = self.view_dependence >= GLOSSY
            lines.append(Message("scene.glossy") if glossy else Message("scene.hardly_glossy"))
        return lines

    @property
    def convex(self) -> bool:
        """Whether hardly a ray from the surface meets it again."""
        return self.self_visibility < 0.001

    @property
    def matte(self) -> bool:
        """Whether the photos show no reflections to speak of."""
        return self.view_dependence is not None and self.view_dependence < MATTE

    def plan(self, preset: Preset) -> Plan:
        """What stage 2 needs."""
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


def seconds_of_cones(whole: MaterialPreset, less: MaterialPreset, seconds: float) -> dict[str, float]:
    """Seconds that the cones left out of `whole` would have taken, where those of `less` took `seconds`."""
    dropped_levels = len(whole.roughness_levels) - len(less.roughness_levels)
    left_out = {
        str(Part.IRRADIANCE): whole.irradiance_cones - less.irradiance_cones,
        str(Part.NARROW_CONES): dropped_levels * whole.specular_cones,
    }
    traced = less.irradiance_cones + len(less.roughness_levels) * less.specular_cones
    return {what: seconds * cones / traced for what, cones in left_out.items() if cones}


def self_visibility(tracer: RayTracer, rng: np.random.Generator, points: int = 4000, directions: int = 8) -> float:
    """Share of cosine-weighted rays from points spread evenly over a mesh that meet the mesh again."""
    face, barycentric = _spread(tracer, points, rng)
    face, barycentric = face.repeat(directions), barycentric.repeat(directions, 0)
    normal = tracer.face_normals[face]
    # a point on the unit sphere around the tip of the normal: directions go by the cosine (Malley)
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
    """How much the brightness of surface points varies over the photos that see them (`SurfaceAnalysis`), or None."""
    face, barycentric = _spread(tracer, points, rng)
    place = tracer.interpolate(tracer.vertices, face, barycentric).astype(np.float32)
    normal = tracer.smooth_normals(normals, face, barycentric)
    at = torch.from_numpy(place).to(rays.radiance.device)
    count, total, square = (np.zeros(points) for _ in range(3))
    for view, (height, width) in enumerate(rays.size):
        image, ahead = rays.project(view, at)
        column, row = (((image + 1) / 2 * torch.tensor([width, height], device=at.device)).floor().long()).unbind(-1)
        inside = ahead & (column >= 0) & (column < width) & (row >= 0) & (row < height)
        index = rays.offset[view] + (row * width + column).clamp(0, height * width - 1)
        eye, _, _ = rays.rays(index)
        to_eye = eye.cpu().numpy() - place
        to_eye /= np.maximum(np.linalg.norm(to_eye, axis=1, keepdims=True), 1e-9)
        seen = (inside & rays.valid[index]).cpu().numpy() & ((normal * to_eye).sum(1) > least_cosine)
        seen[seen] = ~tracer.occluded(tracer.leave(place[seen], face[seen], to_eye[seen]), to_eye[seen])
        value = rays.photo(index).mean(-1).cpu().numpy()
        count[seen] += 1
        total[seen] += value[seen]
        square[seen] += value[seen].astype(np.float64) ** 2
    often = count >= least_views
    if often.sum() < 0.1 * points:
        return None
    mean = total[often] / count[often]
    deviation = np.sqrt(np.maximum(square[often] / count[often] - mean**2, 0))
    return float(np.quantile(deviation / np.maximum(mean, 1e-6), 0.9))


def _spread(tracer: RayTracer, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Faces [count] and barycentric coordinates [count,3] of points evenly over a mesh."""
    corner = tracer.vertices[tracer.faces].astype(np.float64)
    area = np.linalg.norm(np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1)
    face = rng.choice(len(area), count, p=area / area.sum())
    u = np.sqrt(rng.random(count))
    v = rng.random(count)
    return face, np.stack([1 - u, u * (1 - v), u * v], 1)


def _percent(share: float) -> float:
    """Rounded to a whole number, or below 10 % to a tenth."""
    return round(100 * share, 1 if share < 0.1 else 0)


def _rounded(facts: dict) -> dict:
    return {k: float(f"{v:.4g}") if isinstance(v, float) else v for k, v in facts.items()}
