"""Tone mapping: the space in which losses compare radiance."""

from __future__ import annotations

import math

import torch

_SCALE = math.log(5.0)
HIGHLIGHT = 0.03
"""Tone-mapped value that a highlight e times as bright as the threshold adds."""


def tone_map(radiance: torch.Tensor) -> torch.Tensor:
    """log(1 + 4 x) / log 5 of linear radiance x [...]; negative x counts as 0. 0 stays 0 and 1 stays 1.

    Highlights are not clipped, and they do not dominate a loss.
    """
    return torch.log1p(4 * radiance.clamp(min=0)) / _SCALE


def inverse_tone_map(toned: torch.Tensor) -> torch.Tensor:
    """The linear radiance x [...] of the values tone_map(x)."""
    return torch.expm1(_SCALE * toned) / 4


def tone_map_without_highlights(radiance: torch.Tensor, threshold: float) -> torch.Tensor:
    """`tone_map` up to `threshold`. Above it, the value rises by HIGHLIGHT * log(x / threshold).

    That is little, but enough to distinguish brighter from darker highlights.
    """
    return tone_map(radiance.clamp(max=threshold)) + HIGHLIGHT * (radiance / threshold).clamp(min=1).log()
