"""Places on a ray in the contracted coordinate w (`segments`). The functions are for the Numba kernels."""

from __future__ import annotations

import math

from blender_nep.ops.compilation import kernel

SMALLEST_ANGLE = 1e-9
"""Smallest angle z outside the contraction radius. At 0 the place would lie at infinity."""


@kernel(inline="always", fastmath=True, error_model="numpy")
def contraction_border(b, contraction_radius):
    """(w, z) at which a ray with the closest distance b crosses the contraction radius, w >= 0."""
    border = min(b / contraction_radius, 1.0)
    return math.acosh(1.0 / border), math.asin(border)


@kernel(inline="always", fastmath=True, error_model="numpy")
def place_on_ray(w, exp_w, b, border, contraction_radius, to_shell):
    """(signed distance from the closest point, shell coordinate) at w. exp_w is exp(w), border is `contraction_border`.

    Only inside the contraction radius is exp_w used, so that a march can update it by a factor.
    """
    w_border, z_border = border
    if abs(w) <= w_border:
        inverse = 1.0 / exp_w
        t = 0.5 * b * (exp_w - inverse)
        u = math.log(0.5 * b * (exp_w + inverse))
    else:
        z = max(z_border - (abs(w) - w_border) * b / contraction_radius, SMALLEST_ANGLE)
        t = math.copysign(b / math.tan(z), w)
        u = math.log(contraction_radius) + 1.0 - contraction_radius * math.sin(z) / b
    return t, u * to_shell


@kernel(inline="always", fastmath=True, error_model="numpy")
def far_share(shell, border, spacing):
    """Share of the color detail at a shell coordinate: 0 inside the contraction radius, 1 beyond twice that radius.

    `border` is the shell coordinate of the contraction radius; `spacing` is the distance of the shells in u.
    """
    return min(max(2.0 * (shell - border) * spacing, 0.0), 1.0)
