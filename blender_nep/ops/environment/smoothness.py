"""Total variation of a spherical grid, with its gradient. The body is Numba's on the CPU, and plain torch elsewhere."""

from __future__ import annotations

import numpy as np
import torch
from numba import prange

from blender_nep.ops.compilation import kernel
from blender_nep.ops.precision import at_least_float32


@kernel(inline="always", fastmath=True, error_model="numpy")
def _pull(low, high, scale, softness, pull):
    """The cost of the differences between low and high [m]: the sum of scale * sqrt((high - low)^2 + softness^2).

    Fills pull [m] with its derivatives by `high`.
    """
    total = 0.0
    for i in range(low.shape[0]):
        difference = high[i] - low[i]
        length = np.sqrt(difference * difference + softness * softness)
        total += scale[i] * length
        pull[i] = scale[i] * difference / length
    return total


@kernel(parallel=True, fastmath=True, error_model="numpy")
def _add_variation(grid, channels, scale, softness, value, gradient):
    """Add the gradient of `total_variation` to gradient [K, H, W C], and fill value [H] with the part of each row.

    grid is [K, H, W C], where C is `channels`. scale [3, W C] holds the weights of the differences from shell to shell, row
    to row, and column to column. The loops go over whole rows, so that they become vector instructions.
    """
    shells, rows, m = grid.shape
    for row in prange(rows):
        total, after = 0.0, np.empty(m, grid.dtype)
        to_shell, to_row, from_row = np.zeros(m, grid.dtype), np.zeros(m, grid.dtype), np.zeros(m, grid.dtype)
        to_column, from_shell = np.empty(m, grid.dtype), np.zeros(m, grid.dtype)
        for k in range(shells):
            here, slope = grid[k, row], gradient[k, row]
            if k + 1 < shells:
                total += _pull(here, grid[k + 1, row], scale[0], softness, to_shell)
            else:
                to_shell[:] = 0
            if row + 1 < rows:
                total += _pull(here, grid[k, row + 1], scale[1], softness, to_row)
            if row > 0:  # this cost is already in the sum of the row before
                _pull(grid[k, row - 1], here, scale[1], softness, from_row)
            for i in range(m - channels):
                after[i] = here[i + channels]
            for i in range(channels):
                after[m - channels + i] = here[i]
            total += _pull(here, after, scale[2], softness, to_column)
            for i in range(channels):
                slope[i] += (
                    from_shell[i] + from_row[i] + to_column[m - channels + i] - to_shell[i] - to_row[i] - to_column[i]
                )
            for i in range(channels, m):
                slope[i] += from_shell[i] + from_row[i] + to_column[i - channels] - to_shell[i] - to_row[i] - to_column[i]
            to_shell, from_shell = from_shell, to_shell
        value[row] = total


def total_variation(grid: torch.Tensor, weight: tuple[float, ...], softness: float) -> torch.Tensor:
    """Sum over the three axes and the channels of weight * mean of sqrt(difference^2 + softness^2). A scalar.

    It is plain torch, for any device and any float type, and differentiable.

    Args:
        grid: [K, H, W, C], periodic in W. K may be 1; H is at least 2.
        weight: C weights, one for each channel.
        softness: differences below this cost quadratically, larger ones linearly.
    """
    (grid,) = at_least_float32(grid)
    differences = (grid.diff(dim=0), grid.diff(dim=1), grid.roll(-1, 2) - grid)
    means = [torch.sqrt(d * d + softness**2).mean(dim=(0, 1, 2)) for d in differences if d.numel()]
    return torch.stack(means).sum(0) @ grid.new_tensor(weight)


def add_total_variation_gradient(
    grid: torch.Tensor, weight: tuple[float, ...], softness: float, gradient: torch.Tensor
) -> torch.Tensor:
    """Add the gradient of `total_variation` to `gradient` [K, H, W, C] in place. Returns the value [] without a gradient.

    The Numba body needs a `gradient` on the CPU that is contiguous and has the type of the grid, float32 or float64. For
    any other, it is plain torch, which is slower, because it writes and adds whole grids.
    """
    fused = grid.device.type == "cpu" and grid.dtype == gradient.dtype and grid.element_size() >= 4
    if not (fused and gradient.is_contiguous()):
        grid = grid.detach().requires_grad_()
        with torch.enable_grad():
            value = total_variation(grid, weight, softness)
        gradient += torch.autograd.grad(value, grid)[0]
        return value.detach()
    slab = grid.detach().contiguous().numpy()
    shells, rows, columns, channels = slab.shape
    counts = max(shells - 1, 1) * rows * columns, shells * (rows - 1) * columns, shells * rows * columns
    scale = np.tile(np.asarray(weight) / np.asarray(counts)[:, None], columns).astype(slab.dtype)
    parts, flat = np.empty(rows), (shells, rows, columns * channels)
    _add_variation(slab.reshape(flat), channels, scale, slab.dtype.type(softness), parts, gradient.numpy().reshape(flat))
    return grid.new_tensor(parts.sum())
