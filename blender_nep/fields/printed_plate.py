"""Takes the print of a turntable's plate out of the silhouettes of what turns.

A plain plate looks the same in all turns. So it counts as still, and nothing is done: the foot of a metal mirrors the plate,
and has its color. A printed plate differs from what stands still wherever photos see it. This tells the two apart.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from blender_nep.capture.rays.pixel_rays import PixelRays
from blender_nep.capture.rays.ray_bundle import RayBundle
from blender_nep.evidence.small_photos import SmallPhotos
from blender_nep.fields.visual_hull import background_silhouettes
from blender_nep.support.plane import Support
from blender_nep.support.plate_print import plate_print
from blender_nep.support.texture import PlaneTexture

PRINTED = 0.5
"""A plate is printed if more than this share of the blocks that show its sharp colors differ from what stands still.
Measured: 0.90 on a printed plate, and 0.10 on a plain one, whose sharp colors are those of its rim and of the object's
shadow."""
ALIKE = 0.04
"""Blocks show a color of the plate if they differ from it by less, tone-mapped."""
LEAST_BLOCKS = 30
"""A photo shows at least so many such blocks of a printed plate, in the mean."""
OFF_PRINT = 0.12
"""Blocks that differ from the print by half of this or more, tone-mapped, may show the object."""


@dataclass(frozen=True)
class PrintedPlate:
    """What is known of the print, and how much the photos differ from it."""

    rays: PixelRays
    photos: SmallPhotos
    texture: PlaneTexture
    block: int
    """Side of the blocks over which photos are averaged, in pixels"""

    @classmethod
    def of(cls, rays: PixelRays, support: Support, block: int) -> PrintedPlate:
        """What would be the print on a support plane. Takes about a CPU second."""
        photos = SmallPhotos(rays)
        return cls(rays, photos, plate_print(photos, support), block)

    def is_seen(self, differences: list[Tensor]) -> bool:
        """Whether the plate is printed; False for a plain one.

        differences: for each view [H / block, W / block], how much its photo differs from what stands still. From 0.5 on, it
        differs.
        """
        shown = [(off < ALIKE) & voting for off, voting in zip(self.off_print, self.voting(differences), strict=True)]
        blocks = int(sum(part.sum() for part in shown))
        turning = int(sum(((values >= 0.5) & part).sum() for values, part in zip(differences, shown, strict=True)))
        return blocks >= LEAST_BLOCKS * self.rays.views and turning > PRINTED * blocks

    def voting(self, differences: list[Tensor]) -> list[Tensor]:
        """For each view [H / block, W / block] bool: the blocks near the sphere of views whose differences are known.

        Beside the sphere, differences are not looked for.
        """
        maps = background_silhouettes(lambda rays: torch.full_like(rays.directions, torch.nan), self.rays, self.block)
        return [value.isnan() & own.isfinite() for value, own in zip(maps, differences, strict=True)]

    def beside(self, sdf: np.ndarray) -> PrintedPlate:
        """The same plate, of which more is known: an object with the SDF [n, n, n] hides it where it does not count.

        What was known before and is not found again is kept.
        """
        found, before = plate_print(self.photos, self.texture.support, sdf), self.texture
        color = torch.where(found.known[..., None], found.color, before.color)
        return replace(self, texture=replace(found, color=color, known=found.known | before.known))

    def taken_out(self, silhouettes: list[Tensor]) -> list[Tensor]:
        """The silhouettes [H / block, W / block], 0..1, of all views, without what shows the print."""
        values = [(0.5 * off / OFF_PRINT).clamp(max=1) for off in self.off_print]
        return [
            torch.where(value.isnan(), own, torch.minimum(own, value))
            for own, value in zip(silhouettes, values, strict=True)
        ]

    @cached_property
    def off_print(self) -> list[Tensor]:
        """For each view [H / block, W / block]: how much its photo differs from the print, tone-mapped; NaN beside it."""

        def color(rays: RayBundle) -> Tensor:
            _, found, known = self.texture.met(rays)
            return torch.where(known[:, None], found, torch.nan)

        def all_of(rays: RayBundle) -> Tensor:
            return torch.ones(len(rays.directions), dtype=torch.bool, device=rays.directions.device)

        return background_silhouettes(color, self.rays, self.block, all_of)
