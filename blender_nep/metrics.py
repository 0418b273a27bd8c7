"""The tone-mapped space in which photos are compared."""

from __future__ import annotations

import math

import torch

_SCALE = math.log(5.0)


def tone_map(radiance: torch.Tensor) -> torch.Tensor:
    """log(1 + 4 x) / log 5 of linear radiance >= 0 [...]: 0 -> 0, 1 -> 1, and highlights neither clip nor rule."""
    return torch.log1p(4 * radiance.clamp(min=0)) / _SCALE
