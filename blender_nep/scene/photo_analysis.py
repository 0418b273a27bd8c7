"""Analyzes the photos: what they show, and which parts of the method they do not need."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import torch

from blender_nep.capture.exposure.surroundings import stops
from blender_nep.capture.rays.pixel_rays import BRIGHTEST_CLIPPED, SATURATED
from blender_nep.capture.rays.pixel_width import pixel_width
from blender_nep.messages import Message, Part
from blender_nep.scene.analysis import Analysis, Plan, percent

if TYPE_CHECKING:
    from blender_nep.capture import PixelRays
    from blender_nep.presets import Preset

_CAST = 0.05
"""Standard deviation of the gains' logarithms over the channels from which on an artist sees a color cast."""
_PIXELS = 300_000
"""Number of pixels that are analyzed, of all photos together."""


@dataclass(frozen=True)
class PhotoAnalysis(Analysis):
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
    curve: float
    """Strength of the camera's response curve that the exposures have told, and that is undone; 0 if there is none"""
    exposure_stops: float
    """Stops between the photos with the lowest and the highest exposure; 0 if all are equal, or if they cannot be found"""
    corner_stops: float
    """Stops by which the photos' corners are brighter than their middles, before that is evened out; negative: darker"""
    white_balance: float
    """Standard deviation of the logarithms of the channels' gains from their mean over the channels; 0 if all photos have
    one white balance, or if it cannot be found"""
    turntable: bool = False
    """The object turned while the camera and the light stood still."""

    @classmethod
    def of(cls, rays: PixelRays) -> PhotoAnalysis:
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
            curve=0.0 if rays.curve_of_files is None else rays.curve_of_files.strength,
            exposure_stops=0.0 if rays.gain is None else float(np.ptp(stops(rays.gain))),
            corner_stops=0.0 if rays.vignetting is None else rays.vignetting.corner_stops,
            white_balance=0.0 if rays.gain is None else float(_color(rays.gain).square().mean().sqrt()),
            turntable=rays.turntable is not None,
        )

    def sentences(self) -> list[Message]:
        """Sentences on the photos that an artist wants to know."""
        if self.backdrop:
            lines = [Message("scene.surroundings", {"photos": self.photos})]
        else:
            lines = [Message("scene.cut_outs", {"photos": self.photos})]
        if self.turntable:
            lines.append(Message("scene.turntable"))
        lines.append(Message("scene.masks_used") if self.masks else Message("scene.masks_not_used"))
        lines.append(self._range())
        exposure, white_balance = self.exposure_stops >= 0.1, self.white_balance > _CAST
        if exposure and white_balance:
            lines.append(Message("scene.exposure_and_white_balance_differ", {"stops": self.exposure_stops}))
        elif exposure:
            lines.append(Message("scene.exposure_differs", {"stops": self.exposure_stops}))
        elif white_balance:
            lines.append(Message("scene.white_balance_differs"))
        if self.curve:
            lines.append(Message("scene.curve_undone"))
        if self.corner_stops:
            lines.append(Message("scene.vignetting", {"stops": -self.corner_stops}))
        return [*lines, self._size()]

    def _range(self) -> Message:
        """The sentence on whether highlights are clipped."""
        if self.clipped >= 0.001 and self.masks:
            return Message("scene.object_clipped", {"percent": percent(self.clipped)})
        if self.clipped >= 0.001:
            return Message("scene.sphere_clipped", {"percent": percent(self.clipped)})
        return Message("scene.high_range") if self.brightest > BRIGHTEST_CLIPPED else Message("scene.hardly_clipped")

    def _size(self) -> Message:
        """The sentence on how much of the photos the sphere takes, and the object in it."""
        pixels, sphere = self.pixels_across, percent(self.sphere_share)
        if self.object_share is None:
            return Message("scene.sphere_size", {"pixels": pixels, "percent": sphere})
        object_percent = percent(self.object_share)
        return Message("scene.object_size", {"pixels": pixels, "percent": sphere, "object_percent": object_percent})

    def plan(self, preset: Preset) -> Plan:
        """The preset without the parts that these photos do not need, for fields learning and material learning."""
        skipped: dict[str, Message] = {}
        if self.turntable:  # the diffuse light differs between photos, too, and has the hue of the object
            material = preset.material
            without, samples = (*material.without, "hue"), max(material.unseen_samples, material.turning_unseen_samples)
            preset = replace(preset, material=replace(material, without=without, unseen_samples=samples))
            skipped[Part.HUE] = Message("reason.turntable")
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
