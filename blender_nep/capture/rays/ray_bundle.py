"""Rays in the unit frame, with the cones of their pixels."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from torch import Tensor


@dataclass(frozen=True)
class RayBundle:
    """n rays in the unit frame. It can be unpacked: origins, directions, half angles."""

    origins: Tensor
    """[n, 3], in object radii"""
    directions: Tensor
    """[n, 3] unit vectors"""
    half_angle: Tensor
    """[n] half angles of the pixels' cones in radians: a cone has its pixel's solid angle"""

    def __len__(self) -> int:
        return len(self.origins)

    def __iter__(self) -> Iterator[Tensor]:
        return iter((self.origins, self.directions, self.half_angle))

    def __getitem__(self, index: Tensor) -> RayBundle:
        return RayBundle(self.origins[index], self.directions[index], self.half_angle[index])
