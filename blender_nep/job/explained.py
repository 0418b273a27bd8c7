"""Says at the end of a job how well the asset explains its photos, or the photos that were held out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from blender_nep.messages import Message

if TYPE_CHECKING:
    from blender_nep.asset.photo_score import PhotoScore
    from blender_nep.capture import PixelRays
    from blender_nep.fields.fields import Fields
    from blender_nep.job.stages import SurfaceResult
    from blender_nep.materials.explained_photos import Explained
    from blender_nep.materials.training import Materials
    from blender_nep.presets import Preset

LEAST_OF_OBJECT, MOST_HUE = 18.0, 7.0
"""An asset whose score is lower [dB], or whose hues differ more [degrees], does not explain its photos
(docs/lab/score-without-truth.md)."""
LEAST_OF_SURROUNDINGS = 20.0
"""Surroundings whose score is lower [dB] do not explain the photos."""


@dataclass(frozen=True)
class ExplainedReport:
    """How well the photos are explained, for the report and for people."""

    found: Explained
    hold_out: int | None
    """One photo of this many was held out from learning, and these were scored. None: those that were learned from"""

    def sentences(self) -> list[Message]:
        """What was found, for everybody.

        Of the surroundings nothing is said where all photos were learned from: F_e remembers what they show
        (docs/lab/score-without-truth.md).
        """
        lines, one, beside = [], self.found.object, self.found.surroundings
        if one is not None:
            values = {"decibels": one.psnr, "degrees": one.hue_deg or 0.0}
            if self.hold_out is not None:
                lines.append(Message("scene.explains_held_out", values))
            else:
                lines.append(Message("scene.explains_photos", values))
        if beside is not None and self.hold_out is not None:
            lines.append(Message("scene.surroundings_explained", {"decibels": beside.psnr}))
        return lines

    def warnings(self) -> list[Message]:
        """What the artist should know: the asset, or its light, does not explain the photos."""
        lines, one, beside = [], self.found.object, self.found.surroundings
        if one is not None and (one.psnr < LEAST_OF_OBJECT or (one.hue_deg or 0) > MOST_HUE):
            said = {"decibels": one.psnr, "degrees": one.hue_deg or 0.0, "least": LEAST_OF_OBJECT, "most": MOST_HUE}
            lines.append(Message("job.photos_not_explained", said))
        if beside is not None and beside.psnr < LEAST_OF_SURROUNDINGS:
            values = {"decibels": beside.psnr, "least": LEAST_OF_SURROUNDINGS}
            lines.append(Message("job.surroundings_not_explained", values))
        return lines

    def to_dict(self) -> dict:
        """The entry `explained` of report.json."""
        return {
            "hold_out": self.hold_out,
            "object": _facts(self.found.object),
            "surroundings": _facts(self.found.surroundings),
        }


def _facts(score: PhotoScore | None) -> dict | None:
    if score is None:
        return None
    hue = None if score.hue_deg is None else round(score.hue_deg, 2)
    return {"psnr": round(score.psnr, 2), "hue_deg": hue, "pixels": score.pixels}


def explained(
    rays: PixelRays,
    held_out: PixelRays | None,
    hold_out: int | None,
    fields: Fields,
    surface: SurfaceResult,
    materials: Materials,
    preset: Preset,
    seed: int,
) -> ExplainedReport:
    """Score the asset on the photos `held_out`, or where there are none on the pixels of `rays` that stage 1 held out.

    One photo of `hold_out` was held out; None: none was.
    """
    from blender_nep.asset.export import TEXTURES
    from blender_nep.fields.object_pixels import fitted_to_widths
    from blender_nep.geometry.ray_tracing import RayTracer
    from blender_nep.materials.explained_photos import OF_HITS, NoRadiance, TexturedSurface, explain_photos
    from blender_nep.shading.light_of_photos import LightOfPhotos
    from blender_nep.shading.photographer import Photographer, up_of
    from blender_nep.shading.plenoptic import PlenopticFunction
    from blender_nep.support.light import SupportLight

    mesh, plane, device = surface.surface, surface.support or fields.support, rays.valid.device
    tracer = RayTracer(mesh.vertices, mesh.faces)
    curve, light = materials.response, fields.environment
    lit = rays if curve is None else rays.with_response(curve)
    support = None if plane is None else SupportLight.of(plane, lit, tracer)
    environment = light if curve is None else LightOfPhotos(light, curve)
    f_p = PlenopticFunction(tracer, mesh.normals, environment, NoRadiance(), OF_HITS, device, support, materials.unseen)
    asset = TexturedSurface(mesh, {name: getattr(materials, name) for name in TEXTURES})
    scored = rays if held_out is None else held_out
    every = fitted_to_widths(preset.fields, rays).held_out_every if held_out is None else 1
    gain = materials.object_gain if held_out is None else None
    strength = materials.report.get("photographer", 0.0)
    person = Photographer(strength, up_of(rays.cameras()[1])) if strength else None
    found = explain_photos(asset, f_p, light, scored, every, held_out is not None, seed, curve, gain, person)
    return ExplainedReport(found, hold_out)
