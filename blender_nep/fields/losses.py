"""What stage 1 minimises: the photometric loss, and the priors of both fields with their weights."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from blender_nep.capture.pixel_rays import PixelRays
from blender_nep.fields.rendering import Rendering
from blender_nep.presets import FieldsPreset, Preset
from blender_nep.tone_mapping import tone_map, tone_map_without_highlights


def highlight_threshold(rays: PixelRays, preset: FieldsPreset) -> float:
    """Radiance above which a pixel of the object is a highlight: so many geometric means of what the photos show around
    the object, with masks of what they show of the object. It scales with the photos' exposure."""
    return preset.highlight_threshold * _typical_radiance(rays)


def _typical_radiance(rays: PixelRays, pixels: int = 10_000) -> float:
    """Geometric mean over about `pixels` pixels that see the object's sphere."""
    index = rays.sphere[:: max(1, len(rays.sphere) // pixels)]
    if rays.mask is not None and (rays.mask[index] > 127).any():
        index = index[rays.mask[index] > 127]
    radiance = rays.photo(index)
    brightness = radiance.mean(-1)
    lit = brightness > 0.01 * brightness.quantile(0.9)  # black around a cut-out object is no radiance
    return float(radiance[lit].clamp(min=1e-6).log().mean().exp()) if lit.any() else 1.0


@dataclass(frozen=True)
class FieldsLosses:
    """The loss of rendered rays."""

    preset: FieldsPreset
    foreground_opacity: float
    """Weight of F_e's opacity before the object (EnvironmentPreset.foreground_opacity)"""
    highlight_threshold: float
    """Linear radiance, see the function of this name"""

    @classmethod
    def of(cls, preset: Preset, rays: PixelRays) -> FieldsLosses:
        """With the preset's weights, for the photos `rays`."""
        return cls(preset.fields, preset.environment.foreground_opacity, highlight_threshold(rays, preset.fields))

    def difference(self, out: Rendering, photo: Tensor) -> Tensor:
        """Absolute tone-mapped difference [n, 3] of renderings and photos [n, 3]. As far as the object hides what is behind
        it, highlights hardly count; elsewhere they count in full, so that F_e keeps its lamps."""
        full = (tone_map(out.radiance) - tone_map(photo)).abs()
        dull = tone_map_without_highlights(out.radiance, self.highlight_threshold) - tone_map_without_highlights(
            photo, self.highlight_threshold
        )
        return torch.lerp(full, dull.abs(), out.opacity.detach()[:, None].clamp(max=1))

    def photometric(self, out: Rendering, photo: Tensor) -> Tensor:
        """L_c (eq. 5), scalar: the mean of w_l |rendering - photo|, tone-mapped."""
        return (out.weight * self.difference(out, photo)).mean()

    def total(self, photometric: Tensor, out: Rendering, curvature_weight: float, mask: Tensor | None) -> Tensor:
        """The photometric loss and all priors, scalar; mask [n] is the object's coverage of the pixels, 0..1."""
        p = self.preset
        loss = photometric + p.eikonal * out.eikonal + curvature_weight * out.curvature
        loss = loss + self.foreground_opacity * out.foreground_opacity
        if mask is not None and p.mask > 0:
            # 1e-4: the logarithm of an opacity of exactly 0 or 1 is not finite
            loss = loss + p.mask * functional.binary_cross_entropy(out.opacity.clamp(1e-4, 1 - 1e-4), mask)
        return loss
