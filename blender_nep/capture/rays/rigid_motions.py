"""Rigid motions from the object's frame to the room's: how the object of a turntable stood when a photo was taken."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class RigidMotions:
    """n rigid motions from the object's unit frame to the frame of the room: x_room = rotation @ x_object + offset.

    On a turntable the object turns, while the camera and the light stand still. The room's frame is the object's unit frame
    as the object stood in the first photo.
    """

    rotation: Tensor
    """[n, 3, 3], without a reflection"""
    offset: Tensor
    """[n, 3], in object radii"""

    @classmethod
    def of_still_camera(cls, rotation: Tensor, origin: Tensor, first: tuple[Tensor, Tensor] | None = None) -> RigidMotions:
        """The motions of n photos from one camera that stands still.

        `rotation` [n, 3, 3] are the camera-to-world rotations and `origin` [n, 3] the positions of the cameras, in the
        object's unit frame. `first`: rotation [3, 3] and position [3] of the camera whose photo decides the room's frame.
        None: the first of the n. The axis of the turntable need not be known.
        """
        to, place = (rotation[0], origin[0]) if first is None else first
        turns = to @ rotation.mT
        return cls(turns, place - torch.einsum("nij,nj->ni", turns, origin))

    @classmethod
    def joined(cls, parts: Sequence[RigidMotions]) -> RigidMotions:
        """The motions of all parts, one part after the other."""
        return cls(torch.cat([part.rotation for part in parts]), torch.cat([part.offset for part in parts]))

    def __len__(self) -> int:
        return len(self.rotation)

    def __getitem__(self, index: Tensor | slice) -> RigidMotions:
        return RigidMotions(self.rotation[index], self.offset[index])

    def directions(self, directions: Tensor) -> Tensor:
        """Directions [n, ..., 3] of the object's frame in the room's, one motion for each of the n."""
        return torch.einsum("nij,n...j->n...i", self.rotation, directions)

    def points(self, points: Tensor) -> Tensor:
        """Points [n, ..., 3] of the object's unit frame in the room's, one motion for each of the n."""
        return self.directions(points) + self.offset.view(-1, *[1] * (points.ndim - 2), 3)
