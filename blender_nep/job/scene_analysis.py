"""Analyses the scene: what the photos show, and which parts of the method this scene does not need.

There are two analyses, both cheap and without side effects: one of the photos (`SceneAnalysis.of`), and one of the mesh once
it is there (`SurfaceAnalysis.of`). Each gives facts with numbers, sentences about them, and a preset without the parts that
this scene does not need. If `Preset.skip_needless` is False, all parts are kept, and the sentences are still said.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import torch

from blender_nep.capture.exposure import stops
from blender_nep.capture.rays.pixel_rays import BRIGHTEST_CLIPPED, SATURATED
from blender_nep.capture.rays.pixel_width import pixel_width
from blender_nep.evidence.agreement import variation
from blender_nep.evidence.full_photos import FullPhotos, Sampling
from blender_nep.evidence.observation import observe
from blender_nep.evidence.occluders import MeshOccluder
from blender_nep.geometry.ray_tracing import RayTracer
from blender_nep.messages import Message, Part

if TYPE_CHECKING:
    from blender_nep.capture import PixelRays
    from blender_nep.geometry.mesh import Surface
    from blender_nep.presets import MaterialPreset, Preset

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
_CAST = 0.05
"""Standard deviation of the gains' logarithms over the channels from which on an artist sees a color cast."""
_PIXELS = 300_000
"""Number of pixels that are analyzed, of all photos together."""


@dataclass(frozen=True)
class Plan:
    """The preset for this scene, and {part that is left out: why}."""

    preset: Preset
    skipped: dict[str, Message]


@dataclass(frozen=True)
class SceneAnalysis:
    """Facts about the photos, after they were downscaled to the preset's size."""

    photos: int
    masks: bool
    """The object's masks are there and used."""
    backdrop: bool
    """False: the photos are cut-outs, and nothing is known of the surroundings."""
    brightest: float
    """Largest radiance, linear; about 1 where the files cannot store more"""
    clipped: float
    """Share of the object pixels that have the largest value that the files store. Without masks: of the sphere's pixels"""
    sphere_share: float
    """Share of the photos' valid pixels whose rays meet the object's sphere"""
    object_share: float | None
    """Share of the sphere's pixels that show the object; None without masks"""
    pixels_across: float
    """Number of pixels across the sphere, median over the pixels"""
    exposure_stops: float
    """Stops between the photos with the lowest and the highest exposure; 0 if all are equal, or if they cannot be found"""
    corner_stops: float
    """Stops by which the photos' corners are brighter than their middles, before that is evened out; negative: darker"""
    white_balance: float
    """Standard deviation of the logarithms of the channels' gains from their mean over the channels; 0 if all photos have
    one white balance, or if it cannot be found"""

    @classmethod
    def of(cls, rays: PixelRays) -> SceneAnalysis:
        """Analyze about 300,000 pixels. Takes a tenth of a second."""
        some = rays.sphere[:: max(1, len(rays.sphere) // _PIXELS)]
        shown = None if rays.mask is None else rays.mask[some] > 127
        radiance = rays.radiance[some].float().amax(-1)
        if shown is not None and shown.any():
            radiance = radiance[shown]
        brightest = rays.brightest
        if brightest <= BRIGHTEST_CLIPPED:
            clipped = int((radiance > SATURATED).sum())
        else:  # files of a larger range: if they were clipped, many pixels have the largest value; otherwise only one has it
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
            corner_stops=0.0 if rays.vignetting is None else rays.vignetting.corner_stops,
            white_balance=0.0 if rays.gain is None else float(_color(rays.gain).square().mean().sqrt()),
        )

    def facts(self) -> dict:
        """All fields as plain values, rounded, for report.json."""
        return _rounded(asdict(self))

    def sentences(self) -> list[Message]:
        """Sentences on the photos that an artist wants to know."""
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
        if self.corner_stops:
            lines.append(Message("scene.vignetting", {"stops": -self.corner_stops}))
        return [*lines, self._size()]

    def _range(self) -> Message:
        """The sentence on whether highlights are clipped."""
        if self.clipped >= 0.001 and self.masks:
            return Message("scene.object_clipped", {"percent": _percent(self.clipped)})
        if self.clipped >= 0.001:
            return Message("scene.sphere_clipped", {"percent": _percent(self.clipped)})
        return Message("scene.high_range") if self.brightest > BRIGHTEST_CLIPPED else Message("scene.hardly_clipped")

    def _size(self) -> Message:
        """The sentence on how much of the photos the sphere takes, and the object in it."""
        pixels, percent = self.pixels_across, _percent(self.sphere_share)
        if self.object_share is None:
            return Message("scene.sphere_size", {"pixels": pixels, "percent": percent})
        object_percent = _percent(self.object_share)
        return Message("scene.object_size", {"pixels": pixels, "percent": percent, "object_percent": object_percent})

    def plan(self, preset: Preset) -> Plan:
        """The preset without the parts that these photos do not need, for fields learning and material learning."""
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
    """The logarithms [views, 3] of the gains [views, 3] without their mean over the channels: the white balance."""
    return gain.log() - gain.log().mean(1, keepdim=True)


@dataclass(frozen=True)
class SurfaceAnalysis:
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

    def facts(self) -> dict:
        """All fields as plain values, rounded, for report.json."""
        return _rounded(asdict(self))

    def sentences(self) -> list[Message]:
        """Sentences on the object that an artist wants to know."""
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


def seconds_of_cones(whole: MaterialPreset, less: MaterialPreset, seconds: float) -> dict[str, float]:
    """{part: seconds saved} for the cones of `whole` that `less` leaves out; the cones of `less` took `seconds`."""
    dropped_levels = len(whole.roughness_levels) - len(less.roughness_levels)
    left_out = {
        str(Part.IRRADIANCE): whole.irradiance_cones - less.irradiance_cones,
        str(Part.NARROW_CONES): dropped_levels * whole.specular_cones,
    }
    traced = less.irradiance_cones + len(less.roughness_levels) * less.specular_cones
    return {what: seconds * cones / traced for what, cones in left_out.items() if cones}


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


def _percent(share: float) -> float:
    """The share in percent, rounded to a whole number; below 10 % to a tenth."""
    return round(100 * share, 1 if share < 0.1 else 0)


def _rounded(facts: dict) -> dict:
    return {k: float(f"{v:.4g}") if isinstance(v, float) else v for k, v in facts.items()}
