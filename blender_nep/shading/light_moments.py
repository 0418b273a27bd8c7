"""The light of surface points as their materials need it: moments at several roughness levels, and the irradiance."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from blender_nep.safety.arrays import check_array
from blender_nep.shading.plenoptic import SpecularMoments

_FULL, _EDGE, _DIELECTRIC = range(3)
_NO_LIGHT = 0.02
"""If the photos show less than this share of the light, they count as showing none of it."""


@dataclass(frozen=True, eq=False)
class LightMoments:
    """The whole light of n surface points at R roughness levels, under the materials and the unseen light found so far."""

    specular: Tensor
    """[n, R, 3, 3] light through the specular lobe of each level: three moments with three colors each"""
    diffuse: Tensor
    """[n, 3] irradiance divided by pi"""
    coverage: Tensor
    """[n, R] in 0..1: share of the specular lobe whose light the photos show"""
    cos_v: Tensor
    """[n] cosine between the normal and the direction to the camera"""
    roughness_levels: Tensor
    """[R]"""

    @property
    def in_photos(self) -> bool:
        """Whether the photos show any of the light. They show none if the object is cut out."""
        return float(self.coverage.mean()) >= _NO_LIGHT

    @classmethod
    def joined(cls, first: LightMoments, second: LightMoments) -> LightMoments:
        """The light of the points of both. Their roughness levels are the same."""
        parts = (first.moments_state(), second.moments_state())
        per_point = {name: torch.cat([part[name] for part in parts]) for name in cls._TENSORS if name != "roughness_levels"}
        return cls(**per_point, roughness_levels=first.roughness_levels)

    def moments(self, roughness: Tensor, rows: Tensor | slice = slice(None)) -> SpecularMoments:
        """Moments of the points `rows` [m] at roughness [m] (or a scalar tensor), interpolated between the levels."""
        return self.between_levels(self.specular, roughness, rows)

    def between_levels(self, specular: Tensor, roughness: Tensor, rows: Tensor | slice) -> SpecularMoments:
        """The same for given moments of the levels, specular [n, R, 3, 3]."""
        low, mix = self.roughness_interval(roughness)
        table = specular[rows]
        if low.ndim == 0:
            between = torch.lerp(table[:, low], table[:, low + 1], mix)
        else:
            each = torch.arange(len(table), device=table.device)
            between = torch.lerp(table[each, low], table[each, low + 1], mix[:, None, None])
        return SpecularMoments(between[:, _FULL], between[:, _EDGE], between[:, _DIELECTRIC])

    def roughness_interval(self, roughness: Tensor) -> tuple[Tensor, Tensor]:
        """Index of the roughness level below each roughness [...], and the place between it and the next level, 0..1."""
        levels = self.roughness_levels
        low = (torch.searchsorted(levels, roughness.contiguous(), right=True) - 1).clamp(0, len(levels) - 2)
        return low, ((roughness - levels[low]) / (levels[low + 1] - levels[low])).clamp(0, 1)

    _TENSORS = ("specular", "diffuse", "coverage", "cos_v", "roughness_levels")

    def check(self) -> int:
        """The number of points. Raises ValueError unless the tensors fit each other."""
        levels = check_array("roughness_levels", self.roughness_levels, (None,), low=0.0, high=1.0)
        if levels < 2:
            raise ValueError("there are fewer than 2 roughness levels")
        count = check_array("specular", self.specular, (None, levels, 3, 3))
        check_array("diffuse", self.diffuse, (count, 3))
        check_array("coverage", self.coverage, (count, levels))
        check_array("cos_v", self.cos_v, (count,))
        return count

    def moments_state(self) -> dict[str, Tensor]:
        """The moments as a dict of tensors, from which `LightMoments` can be made again."""
        return {name: getattr(self, name) for name in self._TENSORS}
