"""Rays in the unit frame, with the cones of their pixels."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from torch import Tensor

from blender_nep.capture.rays.rigid_motions import RigidMotions


@dataclass(frozen=True)
class RayBundle:
    """n rays in the unit frame. It can be unpacked: origins, directions, half angles."""

    origins: Tensor
    """[n, 3], in object radii"""
    directions: Tensor
    """[n, 3] unit vectors"""
    half_angle: Tensor
    """[n] half angles of the pixels' cones in radians: a cone has its pixel's solid angle"""
    motion: RigidMotions | None = None
    """n motions to the room's frame: how the object stood when the ray's photo was taken. None: it stood still."""

    def __len__(self) -> int:
        return len(self.origins)

    def __iter__(self) -> Iterator[Tensor]:
        return iter((self.origins, self.directions, self.half_angle))

    def __getitem__(self, index: Tensor) -> RayBundle:
        return RayBundle(self.origins[index], self.directions[index], self.half_angle[index], self.motion_of(index))

    def motion_of(self, index: Tensor) -> RigidMotions | None:
        """The motions of the rays index [m]; None if the object stood still."""
        return None if self.motion is None else self.motion[index]

    def in_room(self) -> RayBundle:
        """The same rays in the room's frame, where the light stands still. Distances along a ray stay the same."""
        if self.motion is None:
            return self
        return RayBundle(self.motion.points(self.origins), self.motion.directions(self.directions), self.half_angle)
