"""The two ends of the environment's prefilter: from densities to weights as seen from the center, and back to opacities."""

from __future__ import annotations

import math

import numpy as np
import torch
from numba import prange

from blender_nep.ops.compilation import kernel
from blender_nep.ops.environment.spherical_grid import COLOR_LIMIT, angular_cell, bilinear, bilinear_weights, cell_columns

RADIAL_STEPS = 4
"""Number of steps in which the weights between two shells are integrated."""
LEAST_WEIGHT = 1e-6
"""A node with a smaller weight takes the color of the node before it."""
LEAST_LEFT = 1e-4
"""If less than this part of the view is left, a node becomes opaque: its opacity would be a ratio of rounding errors."""


@kernel(fastmath=True, error_model="numpy")
def _row_weights_from_center(row, raw, coverage, density_gain, spacing, out):
    """What `_weights_from_center` does with a row of `out`."""
    shells, rows, columns = raw.shape[0], raw.shape[1], raw.shape[2]
    fine_rows, fine_columns = out.shape[1], out.shape[2]
    theta = (row + 0.5) * math.pi / fine_rows
    node, before = np.empty(5), np.empty(5)
    for column in range(fine_columns):
        phi = (column + 0.5) * 2 * math.pi / fine_columns - math.pi
        j, c, fj, fc = angular_cell(
            math.sin(theta) * math.cos(phi), math.sin(theta) * math.sin(phi), math.cos(theta), rows, columns
        )
        top, bottom, tl, tr, bl, br = corners = cell_columns(j, c, rows, columns)
        w0, w1, w2, w3 = weights = bilinear_weights(fj, fc)
        passed = 1.0
        for k in range(shells):
            for h in range(4):
                node[h] = bilinear(raw, k, corners, weights, h)
                out[k, row, column, h] = 0.0
            node[4] = (
                w0 * coverage[k, top, tl]
                + w1 * coverage[k, top, tr]
                + w2 * coverage[k, bottom, bl]
                + w3 * coverage[k, bottom, br]
            )
            out[k, row, column, 4] = 0.0
            for step in range(RADIAL_STEPS if k > 0 else 0):
                f = (step + 0.5) / RADIAL_STEPS
                value = before[0] + f * (node[0] - before[0])
                density = density_gain * (max(value, 0.0) + math.log1p(math.exp(-abs(value))))
                alpha = -math.expm1(-density * spacing / RADIAL_STEPS)
                weight = passed * alpha
                passed -= weight
                if weight < 1e-9:
                    continue
                # the weight of a step is shared between the shells on its two sides
                for h in range(1, 4):
                    value = before[h] + f * (node[h] - before[h])
                    value = weight * math.exp(min(max(value, -COLOR_LIMIT), COLOR_LIMIT))
                    out[k - 1, row, column, h - 1] += (1.0 - f) * value
                    out[k, row, column, h - 1] += f * value
                value = weight * (before[4] + f * (node[4] - before[4]))
                out[k - 1, row, column, 3] += (1.0 - f) * weight
                out[k, row, column, 3] += f * weight
                out[k - 1, row, column, 4] += (1.0 - f) * value
                out[k, row, column, 4] += f * value
            for h in range(5):
                before[h] = node[h]
        for h in range(1, 4):
            out[-1, row, column, h - 1] += passed * math.exp(min(max(node[h], -COLOR_LIMIT), COLOR_LIMIT))
        out[-1, row, column, 3] += passed
        out[-1, row, column, 4] += passed * node[4]


@kernel(parallel=True, fastmath=True, error_model="numpy")
def _weights_from_center(raw, coverage, density_gain, spacing, out):
    """Fill out [K, rows, 2 rows, 5], as `weights_from_center`.

    The loop is short for the reason that `environment_rendering_numba._march` tells.
    """
    for row in prange(out.shape[1]):
        _row_weights_from_center(np.int64(row), raw, coverage, density_gain, spacing, out)


@kernel(parallel=True, error_model="numpy")
def _from_weights(weighted, out):
    shells = weighted.shape[0]
    for row in prange(weighted.shape[1]):
        before = np.empty(5)
        for column in range(weighted.shape[2]):
            total = 0.0
            for h in range(5):
                before[h] = 0.0
                for k in range(shells):
                    before[h] += weighted[k, row, column, h]
            total = max(before[3], LEAST_WEIGHT)
            for h in range(5):
                before[h] /= total
            left = total
            for k in range(shells):
                weight = float(weighted[k, row, column, 3])
                if weight > LEAST_WEIGHT:
                    for h in range(5):
                        before[h] = weighted[k, row, column, h] / weight
                opacity = 1.0
                if left > LEAST_LEFT and k < shells - 1:
                    opacity = min(weight / left, 1.0)
                for h in range(5):
                    out[row, column, k, h] = before[h] * opacity
                left -= weight


def weights_from_center(
    raw: torch.Tensor, coverage: torch.Tensor, density_gain: float, spacing: float, rows: int
) -> torch.Tensor:
    """What each shell contributes to the view from the center: (w radiance, w, w coverage) [K, rows, 2 rows, 5].

    raw [K, H, W, 4] (raw density, log radiance) and coverage [K, H, W] in 0..1 are interpolated as in rendering; `spacing`
    is the contracted distance from shell to shell. The weights w of a direction add up to 1, because the last shell is the
    sky.
    """
    out = np.empty((raw.shape[0], rows, 2 * rows, 5), np.float32)
    grid, seen = (a.detach().cpu().float().contiguous().numpy() for a in (raw, coverage))
    _weights_from_center(grid, seen, density_gain, spacing, out)
    return torch.from_numpy(out)


def from_weights(weighted: torch.Tensor) -> np.ndarray:
    """Opacities that composite to given weights, in the memory order that `composite_cones` needs.

    [K, H, W, 5] (w radiance, w, w coverage) -> [H, W, K, 5], the same multiplied by the opacity instead of w. The shells of
    a direction are neighbors in memory. A node is opaque in the last shell, and where hardly anything of the view is left.
    A node of hardly any weight takes the color of the node before it.
    """
    shells, rows, columns, channels = weighted.shape
    out = np.empty((rows, columns, shells, channels), np.float32)
    _from_weights(weighted.contiguous().numpy(), out)
    return out
