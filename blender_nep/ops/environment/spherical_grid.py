"""Finds cells of the environment's spherical grid, and interpolates in them. The functions are for the Numba kernels.

A grid is [K, H, W, C]: K shells, at the distances of `segments`. Each shell is a cell-centered equirectangular
image. Its H rows run from +z to -z; its W = 2 H columns run with atan2(y, x) and are periodic.
"""

from __future__ import annotations

import math

from blender_nep.ops.compilation import kernel

COLOR_LIMIT = 9.0
"""Raw colors are logarithms of radiance. They are clamped to -9..9, so that radiance is at most e^9 = 8100."""

_EIGHTH = math.tan(math.pi / 8)
_ARC_TANGENT = (
    0.9999999999999998,
    -0.33333333333237547,
    0.19999999980211555,
    -0.14285712753451477,
    0.11111051322405656,
    -0.09089568496907766,
    0.07673895822463549,
    -0.06507972285905515,
    0.050307364010978954,
    -0.025391723153007188,
)
"""Coefficients of atan(r) / r in powers of r^2, for r up to _EIGHTH. They are a least-squares fit at 400 Chebyshev nodes.
The angle is right to 1e-15."""


@kernel(inline="always", fastmath=True, error_model="numpy")
def arc_tangent(y, x):
    """math.atan2(y, x) of finite numbers. The larger of |x| and |y| is at least 1e-300, or both are 0. It is right to 1e-14.

    It needs no call of the library, which is slower. The ratio of x and y is brought to at most tan(pi / 8). There the angle
    is a polynomial (`_ARC_TANGENT`).
    """
    wide, high = abs(x), abs(y)
    ratio = min(wide, high) / max(wide, high, 1e-300)
    beyond = ratio > _EIGHTH
    r = (ratio - 1.0) / (ratio + 1.0) if beyond else ratio
    s = r * r
    c0, c1, c2, c3, c4, c5, c6, c7, c8, c9 = _ARC_TANGENT
    angle = r * (c0 + s * (c1 + s * (c2 + s * (c3 + s * (c4 + s * (c5 + s * (c6 + s * (c7 + s * (c8 + s * c9)))))))))
    angle += 0.25 * math.pi if beyond else 0.0
    angle = 0.5 * math.pi - angle if high > wide else angle
    angle = math.pi - angle if x < 0.0 else angle
    return math.copysign(angle, y)


@kernel(inline="always", fastmath=True, error_model="numpy")
def polar(x, y, z):
    """(turn, fall) of a direction: the azimuth from -x in turns, 0..1, and the angle from +z in half turns, 0..1."""
    fall = arc_tangent(math.sqrt(x * x + y * y), z) * (1.0 / math.pi)
    return arc_tangent(y, x) * (0.5 / math.pi) + 0.5, fall


@kernel(inline="always", fastmath=True, error_model="numpy")
def cell(turn, fall, rows, columns):
    """The cell of `polar` angles in a cell-centered equirectangular grid. The result is that of `angular_cell`."""
    v = fall * rows + 0.5
    j = min(int(v), rows)
    u = turn * columns + (columns - 0.5)
    c = int(u)
    return j, c - columns if c >= columns else c, v - j, u - c


@kernel(inline="always", fastmath=True, error_model="numpy")
def angular_cell(x, y, z, rows, columns):
    """The cell of a direction in a cell-centered equirectangular grid: (row + 1, column, row fraction, column fraction).

    Rows run from +z (0) to -z, columns with atan2(y, x). The first result lies in 0..rows: 0 is the cell between the first
    row and the same row across the pole. The column lies in 0..columns - 1, the fractions in 0..1.
    """
    turn, fall = polar(x, y, z)
    return cell(turn, fall, rows, columns)


@kernel(inline="always", fastmath=True, error_model="numpy")
def cell_columns(j, c, rows, columns):
    """The two rows of a cell, and two columns for each row. Across a pole, the columns are shifted by half a turn.

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


@kernel(inline="always", fastmath=True, error_model="numpy")
def bilinear_weights(fj, fc):
    """Weights of a cell's corners, in the order of `cell_columns`, at the row fraction fj and the column fraction fc."""
    return (1.0 - fj) * (1.0 - fc), (1.0 - fj) * fc, fj * (1.0 - fc), fj * fc


@kernel(inline="always", fastmath=True, error_model="numpy")
def bilinear(grid, k, corners, weights, channel):
    """The bilinear value of one channel of shell k, for `corners` of `cell_columns` and `weights` of `bilinear_weights`."""
    top, bottom, tl, tr, bl, br = corners
    w0, w1, w2, w3 = weights
    return (
        w0 * grid[k, top, tl, channel]
        + w1 * grid[k, top, tr, channel]
        + w2 * grid[k, bottom, bl, channel]
        + w3 * grid[k, bottom, br, channel]
    )


@kernel(inline="always", fastmath=True, error_model="numpy")
def bilinear_2d(image, corners, weights, channel):
    """The bilinear value of one channel of an image [H, 2 H, C] of all directions. The arguments are those of `bilinear`."""
    top, bottom, tl, tr, bl, br = corners
    w0, w1, w2, w3 = weights
    upper = w0 * image[top, tl, channel] + w1 * image[top, tr, channel]
    return upper + w2 * image[bottom, bl, channel] + w3 * image[bottom, br, channel]


@kernel(inline="always", fastmath=True, error_model="numpy")
def trilinear(grid, k, shell_weights, corners, weights, channel):
    """The trilinear value of one channel between the shells k and k + 1, whose two `shell_weights` add up to 1.

    The other arguments are those of `bilinear`.
    """
    inner, outer = shell_weights
    return inner * bilinear(grid, k, corners, weights, channel) + outer * bilinear(grid, k + 1, corners, weights, channel)
