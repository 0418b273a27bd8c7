"""The person who takes the photos: from which directions the person, and the person's shadow, take light from the object.

The person stands behind the camera. Seen from the object, the head is beside the camera, and the body is below it. The floor
and the table on that side are in the person's shadow. Other photos show them without it, so F_e is too bright there for this
photo. All of this is fixed to the camera. One number tells how much light it takes. The form was chosen on a rendered person
in a living room (docs/lab/photographer.md).
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

from blender_nep.capture.cameras.upright import upward

_BODY, _FLOOR, _HEAD = 0.8, 0.3, 0.3
"""How dark the lobes towards the body, the floor before it, and the camera are: logarithms of what is left at strength 1"""
_OF_BODY, _OF_FLOOR, _OF_HEAD = 4.0, 1.5, 8.0
"""Sharpness of the lobes towards the body, the floor and the camera: exp(sharpness * (cos - 1)). They are half as strong 34,
57 and 24 degrees from their middles."""
_BESIDE = 0.3
"""The body fades if the camera is nearer to straight above than this, as a sine."""
STRENGTHS = (0.75, 1.5, 2.25, 3.0)
"""Strengths at which a lobe's light is known. Between them, it is interpolated."""


@dataclass(frozen=True)
class Photographer:
    """The person behind the cameras of one capture."""

    strength: float
    """How much light the person takes, as a multiple of `shadow`"""
    up: Tensor
    """[3] unit vector"""

    def left(self, direction: Tensor, view: Tensor) -> Tensor:
        """The share [...] of the light from unit directions [..., 3] that is left; view [..., 3] points to the camera."""
        return torch.exp(-self.strength * shadow(direction, view, self.up))


def at_strength(shadow: Tensor, strength: float) -> Tensor:
    """How much darker [...] it is at a strength, from shadow [..., S] at STRENGTHS. Beyond the last, in proportion."""
    step = STRENGTHS[0]
    low = min(int(strength / step), len(STRENGTHS) - 1)
    before = shadow[..., low - 1] if low else torch.zeros_like(shadow[..., 0])
    return torch.lerp(before, shadow[..., low], strength / step - low)


def up_of(rotations: Tensor) -> Tensor:
    """The unit vector [3] that is up for cameras with camera-to-world rotations [views, 3, 3]."""
    right, above = (rotations[:, :, axis].double().cpu().numpy() for axis in (0, 1))
    return torch.from_numpy(upward(right, above)).to(rotations)


def shadow(direction: Tensor, view: Tensor, up: Tensor) -> Tensor:
    """How much darker light from unit directions [..., 3] is at strength 1, as a natural logarithm >= 0: [...].

    view [..., 3] are unit vectors to the camera, and `up` [3] is up.
    """
    aside = view - (view * up).sum(-1, keepdim=True) * up
    length = aside.norm(dim=-1, keepdim=True)
    level = aside / length.clamp_min(1e-6)
    below = functional.normalize(level - up, dim=-1)
    body = _BODY * _lobe(direction, level, _OF_BODY) + _FLOOR * _lobe(direction, below, _OF_FLOOR)
    return body * (length[..., 0] / _BESIDE).clamp_max(1) + _HEAD * _lobe(direction, view, _OF_HEAD)


def _lobe(direction: Tensor, middle: Tensor, sharpness: float) -> Tensor:
    return torch.exp(sharpness * ((direction * middle).sum(-1) - 1))
