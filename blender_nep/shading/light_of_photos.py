"""The environment field as light, where photos have passed through a camera's response curve.

F_e is learned from photos, so it holds what the camera made of the light. Stage 2 needs the light itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from blender_nep.capture.rays.response_curve import ResponseCurve
from blender_nep.shading.environment import Environment


@dataclass(frozen=True)
class LightOfPhotos:
    """The light behind an environment that was learned from photos with this curve.

    The curve is undone on the mean of a cone. The mean of a narrow cone, of which one lamp fills a part, comes out too
    dark below white, and slightly too bright beyond.
    """

    photos: Environment
    curve: ResponseCurve

    def query_cone(self, origins: Tensor, directions: Tensor, half_angle: Tensor) -> tuple[Tensor, Tensor]:
        """As `Environment.query_cone`."""
        radiance, coverage = self.photos.query_cone(origins, directions, half_angle)
        return self._light(radiance, coverage), coverage

    def equirect(self, height: int) -> tuple[Tensor, Tensor]:
        """As `Environment.equirect`."""
        radiance, coverage = self.photos.equirect(height)
        return self._light(radiance, coverage), coverage

    def extrapolated(self, height: int) -> Tensor:
        """As `Environment.extrapolated`."""
        return self.curve.light(self.photos.extrapolated(height))

    def typical_distance(self) -> float:
        """As `Environment.typical_distance`."""
        return self.photos.typical_distance()

    def _light(self, radiance: Tensor, coverage: Tensor) -> Tensor:
        """The light [..., 3] of a radiance [..., 3] that already counts only as far as the coverage [...] says."""
        share = coverage.clamp(0, 1)[..., None]
        return torch.where(share > 1e-4, share * self.curve.light(radiance / share.clamp_min(1e-4)), radiance)
