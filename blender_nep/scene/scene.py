"""The scene of a job: one value that goes to every stage."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import torch

from blender_nep.capture.rays.pixel_rays import PixelRays
from blender_nep.scene.photo_analysis import PhotoAnalysis
from blender_nep.support.agreed_colors import AgreedColors
from blender_nep.support.plane import Support


@dataclass(frozen=True)
class Scene:
    """The photos, and what is known about the scene before a stage begins.

    What a stage finds is in its result; the next stage gets a new scene.
    """

    rays: PixelRays
    """The pixels of all photos"""
    photos: PhotoAnalysis
    """What the photos show"""
    support: Support | None = None
    """The plane on which the object stands; None as long as none was found"""
    expected_response: float | None = None
    """The strength of the camera's response curve that the photo files make likely. None: their values are linear"""

    @classmethod
    def of(cls, rays: PixelRays, expected_response: float | None = None) -> Scene:
        """The scene of these photos, which are analyzed for it. Takes a tenth of a second."""
        return cls(rays, PhotoAnalysis.of(rays), expected_response=expected_response)

    @property
    def device(self) -> torch.device:
        """The device of the pixels. All stages compute there."""
        return self.rays.radiance.device

    @cached_property
    def plane_colors(self) -> AgreedColors | None:
        """Finds the support plane's colors for stage 1; None without a plane. It is made once, in about a CPU second."""
        return None if self.support is None else AgreedColors(self.rays, self.support)

    def with_support(self, found: Support | None) -> Scene:
        """The scene with the plane that was found. If none was found, the scene as it is."""
        return self if found is None else replace(self, support=found)
