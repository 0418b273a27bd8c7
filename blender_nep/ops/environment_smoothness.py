"""Total variation of a spherical grid, with its gradient. The body is Numba's on the CPU, and plain torch elsewhere."""

from __future__ import annotations

import math

import numpy as np
import torch
from numba import njit, prange

from blender_nep.ops.precision import at_least_float32


@njit(cache=True, parallel=True, fastmath=True, error_model="numpy")
def _variation(grid, weight, softness, value, gradient):
    shells, rows, columns, channels = grid.shape
    squared = softness * softness
    scale = np.empty((3, channels))
    for h in range(channels):
        scale[0, h] = weight[h] / (max(shells - 1, 1) * rows * columns)
        scale[1, h] = weight[h] / (shells * (rows - 1) * columns)
        scale[2, h] = weight[h] / (shells * rows * columns)
    for row in prange(rows):
        total = 0.0
        for k in range(shells):
            for column in range(columns):
                after = column + 1 if column + 1 < columns else 0
                left = column - 1 if column > 0 else columns - 1
                for h in range(channels):
                    here = grid[k, row, column, h]
                    slope = 0.0
                    if k + 1 < shells:
                        d = grid[k + 1, row, column, h] - here
                        length = math.sqrt(d * d + squared)
                        total += scale[0, h] * length
                        slope -= scale[0, h] * d / length
                    if k > 0:
                        d = here - grid[k - 1, row, column, h]
                        slope += scale[0, h] * d / math.sqrt(d * d + squared)
                    if row + 1 < rows:
                        d = grid[k, row + 1, column, h] - here
                        length = math.sqrt(d * d + squared)
                        total += scale[1, h] * length
                        slope -= scale[1, h] * d / length
                    if row > 0:
                        d = here - grid[k, row - 1, column, h]
                        slope += scale[1, h] * d / math.sqrt(d * d + squared)
                    d = grid[k, row, after, h] - here
                    length = math.sqrt(d * d + squared)
                    total += scale[2, h] * length
                    slope -= scale[2, h] * d / length
                    d = here - grid[k, row, left, h]
                    slope += scale[2, h] * d / math.sqrt(d * d + squared)
                    gradient[k, row, column, h] = slope
        value[row] = total


class _VariationNumba(torch.autograd.Function):
    @staticmethod
    def forward(ctx, grid, weight, softness):
        slab = grid.detach().numpy()
        value, gradient = np.empty(slab.shape[1]), np.empty(slab.shape, slab.dtype)
        _variation(slab, np.asarray(weight, np.float64), softness, value, gradient)
        ctx.gradient = torch.from_numpy(gradient)
        return grid.new_tensor(value.sum())

    @staticmethod
    def backward(ctx, g):
        return ctx.gradient * g, None, None


def total_variation(grid: torch.Tensor, weight: tuple[float, ...], softness: float, body: str = "auto") -> torch.Tensor:
    """Sum over the three axes and the channels of weight * mean of sqrt(difference^2 + softness^2). A scalar.

    Args:
        grid: [K, H, W, C], periodic in W. K may be 1; H is at least 2.
        weight: C weights, one for each channel.
        softness: differences below this cost quadratically, larger ones linearly.
        body: "auto" (Numba on the CPU, torch elsewhere), "numba" or "torch".
    """
    (grid,) = at_least_float32(grid)
    if body == "torch" or (body == "auto" and grid.device.type != "cpu"):
        differences = (grid.diff(dim=0), grid.diff(dim=1), grid.roll(-1, 2) - grid)
        means = [torch.sqrt(d * d + softness**2).mean(dim=(0, 1, 2)) for d in differences if d.numel()]
        return torch.stack(means).sum(0) @ grid.new_tensor(weight)
    return _VariationNumba.apply(grid, weight, softness)
