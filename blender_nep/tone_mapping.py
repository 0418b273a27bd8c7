"""The tone-mapped space in which photos are compared."""

from __future__ import annotations

import math

import torch

_SCALE = math.log(5.0)
HIGHLIGHT = 0.03
"""What a highlight e times as bright as white adds, tone-mapped."""


def tone_map(radiance: torch.Tensor) -> torch.Tensor:
    """log(1 + 4 x) / log 5 of linear radiance >= 0 [...]: 0 -> 0, 1 -> 1, and highlights neither clip nor rule."""
    return torch.log1p(4 * radiance.clamp(min=0)) / _SCALE


def tone_map_without_highlights(radiance: torch.Tensor, threshold: float) -> torch.Tensor:
    """`tone_map` up to `threshold`. Above it the value rises by HIGHLIGHT log(x / threshold): hardly, and still enough
    to tell brighter from darker."""
    return tone_map(radiance.clamp(max=threshold)) + HIGHLIGHT * (radiance / threshold).clamp(min=1).log()
