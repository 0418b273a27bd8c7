"""Measures of error, and the tone-mapped space in which photos are compared."""

from __future__ import annotations

import math

import torch

_SCALE = math.log(5.0)


def tone_map(radiance: torch.Tensor) -> torch.Tensor:
    """log(1 + 4 x) / log 5 of linear radiance >= 0 [...]: 0 -> 0, 1 -> 1, and highlights neither clip nor rule."""
    return torch.log1p(4 * radiance.clamp(min=0)) / _SCALE


def inverse_tone_map(value: torch.Tensor) -> torch.Tensor:
    """Linear radiance [...] whose tone_map is `value` >= 0."""
    return torch.expm1(value * _SCALE) / 4


def psnr(value: torch.Tensor, truth: torch.Tensor, peak: float = 1.0) -> float:
    """Peak signal-to-noise ratio in dB between two images [...] of one shape."""
    error = float((value.double() - truth.double()).square().mean())
    return math.inf if error == 0 else 10 * math.log10(peak**2 / error)
