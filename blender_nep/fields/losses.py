"""The loss of fields learning: the photometric loss, and the priors with their weights."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from blender_nep.capture.brightness import radiance_of_object, typical_radiance
from blender_nep.capture.rays.pixel_rays import PixelRays
from blender_nep.fields.rendering import Rendering
from blender_nep.presets import EnvironmentPreset, FieldsPreset, Preset
from blender_nep.tone_mapping import tone_map, tone_map_without_highlights


def highlight_threshold(rays: PixelRays, preset: FieldsPreset) -> float:
    """Linear radiance above which an object pixel is a highlight.

    It is `preset.highlight_threshold` times the geometric mean radiance of the pixels that see the object's sphere, or, with
    masks, of the object pixels. So it scales with the photos' exposure.
    """
    of_object = None if rays.mask is None else radiance_of_object(rays)
    return preset.highlight_threshold * (of_object or typical_radiance(rays))


@dataclass(frozen=True)
class FieldsLosses:
    """Computes the loss of rendered rays."""

    preset: FieldsPreset
    environment: EnvironmentPreset
    """It holds the weight of the foreground opacity."""
    highlight_threshold: float
    """Linear radiance above which an object pixel is a highlight"""

    @classmethod
    def of(cls, preset: Preset, rays: PixelRays) -> FieldsLosses:
        """The losses with the preset's weights, for the photos `rays`."""
        return cls(preset.fields, preset.environment, highlight_threshold(rays, preset.fields))

    def difference(self, out: Rendering, photo: Tensor) -> Tensor:
        """Absolute tone-mapped difference [n, 3] between the rendering and the photo's radiance [n, 3].

        Where the object is opaque, highlights hardly count. Where it is transparent, they count in full, so that F_e keeps
        its lamps. In between, the two differences are mixed by the object's opacity.
        """
        full = (tone_map(out.radiance) - tone_map(photo)).abs()
        dull = tone_map_without_highlights(out.radiance, self.highlight_threshold) - tone_map_without_highlights(
            photo, self.highlight_threshold
        )
        return torch.lerp(full, dull.abs(), out.opacity.detach()[:, None].clamp(max=1))

    def photometric(self, out: Rendering, photo: Tensor) -> Tensor:
        """L_c (eq. 5), scalar: the mean of w_l |rendering - photo|, tone-mapped."""
        return (out.weight * self.difference(out, photo)).mean()

    def total(
        self,
        photometric: Tensor,
        out: Rendering,
        curvature_weight: float,
        distortion_weight: float,
        mask: Tensor | None,
        says: Tensor | None = None,
    ) -> Tensor:
        """The photometric loss plus all priors, scalar. mask [n] is the object's coverage of each pixel, 0..1, or None.

        says [n] is 1 where the mask says something about the object, and 0 where something stands before it; None: 1.
        """
        p = self.preset
        loss = photometric + p.eikonal * out.eikonal + curvature_weight * out.curvature
        loss = loss + self.environment.foreground_opacity * out.foreground_opacity
        loss = loss + distortion_weight * out.distortion
        if mask is not None and p.mask > 0:
            # 1e-4: the logarithm of an opacity of exactly 0 or 1 is not finite
            loss = loss + p.mask * functional.binary_cross_entropy(out.opacity.clamp(1e-4, 1 - 1e-4), mask, says)
        return loss
