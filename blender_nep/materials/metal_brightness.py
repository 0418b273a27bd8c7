"""How bright metals are likely to be.

Where most of the light is in no photo, a dark metal in bright light looks nearly like a bright metal in dim light. But no
common bare metal is dark. In linear Rec.709, the brightest channel of the normal reflectance is 0.55 to 0.67 for chromium,
iron, titanium, cobalt, nickel and platinum, and 0.91 to 0.97 for aluminium and silver. Of the colored metals, brass, copper
and gold have 0.9 to 1 (measured n and k of Johnson and Christy 1972 and Palik 1985, as usual tables of renderers give them).
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

GRAY, COLORED = 0.55, 0.85
"""Brightest channel that a gray and a colored metal have at least, as far as it is likely"""
_COLORED_FROM = 0.4
"""A metal is colored if its darkest channel lacks this share of its brightest one. In between, the brightness is between."""
DARKEST, DARK_COST = 0.25, 0.2
"""A metal below the first share of the brightness that is likely costs more: by the second number times the logarithm of
what it lacks. Tarnished brass hardly lacks any (0.2 of 0.85). A metal of 0.05 looks like a black paint, whose coat reflects
0.04."""
_MOST = 0.98
"""No channel is made brighter than this."""


def likely_brightness(albedo: Tensor) -> Tensor:
    """The brightest channel [K] that metals with these albedos [K, 3] are likely to have at least."""
    high, low = albedo.amax(-1), albedo.amin(-1)
    colored = ((1 - low / high.clamp_min(1e-6)) / _COLORED_FROM).clamp(0, 1)
    return GRAY + (COLORED - GRAY) * colored


def missing_brightness(albedo: Tensor, metallic: Tensor) -> Tensor:
    """Logarithm [K] of the factor by which metals are darker than is likely; 0 for others. albedo [K, 3], metallic [K]."""
    lack = (likely_brightness(albedo) / albedo.amax(-1).clamp_min(1e-6)).log().clamp_min(0)
    return lack * (metallic > 0.5)


def cost_of_darkness(albedo: Tensor, metallic: Tensor) -> Tensor:
    """The factor [K], 1 or more, of the error of metals that are too dark to be metals. albedo [K, 3], metallic [K]."""
    return 1 + DARK_COST * (missing_brightness(albedo, metallic) + math.log(DARKEST)).clamp_min(0)


def brightened(albedo: Tensor, metallic: Tensor, factor: float) -> Tensor:
    """The albedos [K, 3] with metals brighter by `factor`, but not beyond 0.98. Their hues stay."""
    most = (_MOST / albedo.amax(-1).clamp_min(1e-6)).clamp_min(1)
    gain = torch.where(metallic > 0.5, most.clamp_max(factor), 1)
    return albedo * gain[:, None]
