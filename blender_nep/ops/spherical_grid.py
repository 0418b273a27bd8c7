"""Cells of the environment's spherical grid, and what the grid holds between its nodes: functions for the Numba kernels.

A grid is [K, H, W, C]: K shells at equal steps of log |x|, each a cell-centred equirectangular image, whose H rows run from
+z to -z and whose W = 2 H columns run with atan2(y, x), periodically.
"""

from __future__ import annotations

import math

from numba import njit

COLOR_LIMIT = 9.0
"""Raw colors are logarithms of radiance; beyond e^9 = 8100 they are clamped."""


@njit(cache=True, inline="always", fastmath=True, error_model="numpy")
def polar(x, y, z):
    """Azimuth in turns from -x, [0, 1], and angle from +z in half turns, [0, 1]."""
    fall = math.atan2(math.sqrt(x * x + y * y), z) * (1.0 / math.pi)
    return math.atan2(y, x) * (0.5 / math.pi) + 0.5, fall


@njit(cache=True, inline="always", fastmath=True, error_model="numpy")
def cell(turn, fall, rows, columns):
    """Cell of `polar` angles in a cell-centred equirectangular grid: see `angular_cell`."""
    v = fall * rows + 0.5
    j = min(int(v), rows)
    u = turn * columns + (columns - 0.5)
    c = int(u)
    return j, c % columns, v - j, u - c


@njit(cache=True, inline="always", fastmath=True, error_model="numpy")
def angular_cell(x, y, z, rows, columns):
    """Cell of a direction in a cell-centred equirectangular grid: (row + 1, column, row fraction, column fraction).

    Rows run from +z (0) to -z; columns with atan2(y, x). The returned row lies in [0, rows]: 0 is the cell between the
    first row and itself across the pole. The column lies in [0, columns).
    """
    turn, fall = polar(x, y, z)
    return cell(turn, fall, rows, columns)


@njit(cache=True, inline="always", fastmath=True, error_model="numpy")
def cell_columns(j, c, rows, columns):
    """The two rows of a cell, and for each its two columns (shifted by half a turn across a pole).

    Returns (upper row, lower row, upper left, upper right, lower left, lower right column).
    """
    c1 = c + 1 if c + 1 < columns else 0
    top, bottom = j - 1, j
    top_left, top_right, bottom_left, bottom_right = c, c1, c, c1
    half = columns // 2
    if j == 0:
        top = 0
        top_left, top_right = (c + half) % columns, (c1 + half) % columns
    if j == rows:
        bottom = rows - 1
        bottom_left, bottom_right = (c + half) % columns, (c1 + half) % columns
    return top, bottom, top_left, top_right, bottom_left, bottom_right


@njit(cache=True, inline="always", fastmath=True, error_model="numpy")
def bilinear_weights(fj, fc):
    """Weights of a cell's corners, in the order of `cell_columns`, at the row fraction fj and the column fraction fc."""
    return (1.0 - fj) * (1.0 - fc), (1.0 - fj) * fc, fj * (1.0 - fc), fj * fc


@njit(cache=True, inline="always", fastmath=True, error_model="numpy")
def bilinear(grid, k, corners, weights, channel):
    """The value of one channel of shell k: `corners` are those of `cell_columns`, `weights` those of `bilinear_weights`."""
    top, bottom, tl, tr, bl, br = corners
    w0, w1, w2, w3 = weights
    return (
        w0 * grid[k, top, tl, channel]
        + w1 * grid[k, top, tr, channel]
        + w2 * grid[k, bottom, bl, channel]
        + w3 * grid[k, bottom, br, channel]
    )


@njit(cache=True, inline="always", fastmath=True, error_model="numpy")
def trilinear(grid, k, shell_weights, corners, weights, channel):
    """The same between shell k and shell k + 1, whose two weights add up to 1."""
    inner, outer = shell_weights
    return inner * bilinear(grid, k, corners, weights, channel) + outer * bilinear(grid, k + 1, corners, weights, channel)
