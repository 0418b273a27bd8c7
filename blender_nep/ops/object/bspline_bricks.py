"""A quadratic B-spline volume on [-1, 1]^3 that has coefficients only in some bricks: value and derivatives at points.

The spline has M cells along an axis, and N = M + 2 coefficients, as `bspline`. They are cut into bricks of BRICK^3. Bricks
that are left out have coefficients 0. So detail near a surface costs memory in proportion to the surface's area.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
import torch
from numba import prange
from torch import Tensor

from blender_nep.ops.compilation import kernel
from blender_nep.ops.object.bspline import axis_taps, contract_torch, row_adjoint, taps_torch
from blender_nep.ops.precision import at_least_float32

BRICK = 4
"""Coefficients of a brick along an axis."""


class Bricks(NamedTuple):
    """The coefficients of a spline with `cells` cells along an axis."""

    slot: Tensor
    """[B, B, B] int32, B = bricks_along_axis(cells): the row of `coefficients` that holds a brick; -1 where there is none"""
    coefficients: Tensor
    """[S, BRICK, BRICK, BRICK]"""
    cells: int


def bricks_along_axis(cells: int) -> int:
    """B, the number of bricks along an axis of a spline with `cells` cells."""
    return -(-(cells + 2) // BRICK)


@kernel(inline="always")
def _empty(slot, i, j, m):
    """Whether no brick holds any of the 3^3 taps that begin at (i, j, m)."""
    for a in (i // BRICK, (i + 2) // BRICK):
        for b in (j // BRICK, (j + 2) // BRICK):
            for c in (m // BRICK, (m + 2) // BRICK):
                if slot[a, b, c] >= 0:
                    return False
    return True


@kernel(inline="always")
def _row(slot, coef, i, j, m, taps):
    """Fill `taps` with the three coefficients that begin at (i, j, m), along the last axis."""
    for q in range(3):
        s = slot[i // BRICK, j // BRICK, (m + q) // BRICK]
        taps[q] = coef[s, i % BRICK, j % BRICK, (m + q) % BRICK] if s >= 0 else coef.dtype.type(0)


@kernel(inline="always")
def brick_value(slot, coef, cells, x, y, z, w, d, e):
    """The value at one point. `w`, `d` and `e` [3, 3] are overwritten."""
    i = axis_taps(x, cells, w[0], d[0], e[0])
    j = axis_taps(y, cells, w[1], d[1], e[1])
    m = axis_taps(z, cells, w[2], d[2], e[2])
    v = w[0, 0] * 0
    if _empty(slot, i, j, m):
        return v
    for a in range(3):
        for c in range(3):
            for q in range(3):
                s = slot[(i + a) // BRICK, (j + c) // BRICK, (m + q) // BRICK]
                if s >= 0:
                    tap = coef[s, (i + a) % BRICK, (j + c) % BRICK, (m + q) % BRICK]
                    v += w[0, a] * w[1, c] * w[2, q] * tap
    return v


@kernel(parallel=True, fastmath=True)
def _forward(slot, coef, cells, points, out, threads):
    n, hessian = points.shape[0], out.shape[1] == 10
    blocks = threads * 4
    for b in prange(blocks):
        w = np.empty((3, 3), coef.dtype)
        d = np.empty((3, 3), coef.dtype)
        e = np.empty((3, 3), coef.dtype)
        row = np.empty(3, coef.dtype)
        for k in range(b * n // blocks, (b + 1) * n // blocks):
            i = axis_taps(points[k, 0], cells, w[0], d[0], e[0])
            j = axis_taps(points[k, 1], cells, w[1], d[1], e[1])
            m = axis_taps(points[k, 2], cells, w[2], d[2], e[2])
            out[k, :] = 0
            if _empty(slot, i, j, m):
                continue
            for a in range(3):
                for c in range(3):
                    _row(slot, coef, i + a, j + c, m, row)
                    s0 = row[0] * w[2, 0] + row[1] * w[2, 1] + row[2] * w[2, 2]
                    s1 = row[0] * d[2, 0] + row[1] * d[2, 1] + row[2] * d[2, 2]
                    ww, wd, dw = w[0, a] * w[1, c], w[0, a] * d[1, c], d[0, a] * w[1, c]
                    out[k, 0] += ww * s0
                    out[k, 1] += dw * s0
                    out[k, 2] += wd * s0
                    out[k, 3] += ww * s1
                    if hessian:
                        s2 = row[0] * e[2, 0] + row[1] * e[2, 1] + row[2] * e[2, 2]
                        out[k, 4] += e[0, a] * w[1, c] * s0
                        out[k, 5] += w[0, a] * e[1, c] * s0
                        out[k, 6] += ww * s2
                        out[k, 7] += d[0, a] * d[1, c] * s0
                        out[k, 8] += dw * s1
                        out[k, 9] += wd * s1


@kernel(parallel=True, fastmath=True)
def _backward(slot, cells, points, grad, coef_grad, threads):
    """Add the adjoint of `_forward` to coef_grad. Each thread has its own rows of coefficients, so threads never race."""
    n, hessian, rows = points.shape[0], grad.shape[1] == 10, coef_grad.shape[0]
    for b in prange(threads):
        low, high = b * rows // threads, (b + 1) * rows // threads
        w = np.empty((3, 3), coef_grad.dtype)
        d = np.empty((3, 3), coef_grad.dtype)
        e = np.empty((3, 3), coef_grad.dtype)
        for k in range(n):
            i = axis_taps(points[k, 0], cells, w[0], d[0], e[0])
            j = axis_taps(points[k, 1], cells, w[1], d[1], e[1])
            m = axis_taps(points[k, 2], cells, w[2], d[2], e[2])
            if _empty(slot, i, j, m):
                continue
            for a in range(3):
                for c in range(3):
                    a0, a1, a2 = row_adjoint(grad, k, w, d, e, a, c, hessian)
                    for q in range(3):
                        s = slot[(i + a) // BRICK, (j + c) // BRICK, (m + q) // BRICK]
                        if low <= s < high:
                            coef_grad[s, (i + a) % BRICK, (j + c) % BRICK, (m + q) % BRICK] += (
                                a0 * w[2, q] + a1 * d[2, q] + a2 * e[2, q]
                            )


class _Sample(torch.autograd.Function):
    @staticmethod
    def forward(ctx, coef, slot, cells, points, channels):
        out = torch.empty(points.shape[0], channels, dtype=coef.dtype)
        threads = numba.get_num_threads()
        _forward(slot.numpy(), coef.detach().numpy(), cells, points.detach().numpy(), out.numpy(), threads)
        ctx.save_for_backward(slot, points)
        ctx.cells, ctx.shape = cells, coef.shape
        return out

    @staticmethod
    def backward(ctx, grad):
        slot, points = ctx.saved_tensors
        coef_grad = torch.zeros(ctx.shape, dtype=grad.dtype)
        threads = numba.get_num_threads()
        _backward(slot.numpy(), ctx.cells, points.detach().numpy(), grad.contiguous().numpy(), coef_grad.numpy(), threads)
        return coef_grad, None, None, None, None


def _on_grid(at: list[Tensor], size: int) -> Tensor:
    """Flat indices [n * 27] into a grid of size^3 for places [n, 3] along each of the three axes."""
    x, y, z = at
    return ((x[:, :, None, None] * size + y[:, None, :, None]) * size + z[:, None, None, :]).reshape(-1)


def sample_bricks_torch(bricks: Bricks, points: Tensor, hessian: bool = False) -> Tensor:
    """The body of `sample_bricks` in plain torch, for any device and any float type."""
    slot, coef, cells = bricks
    i, w, d, e = taps_torch(points, cells)
    tap = torch.arange(3, device=coef.device)
    at = [i[:, a, None] + tap for a in range(3)]
    brick, place = _on_grid([x // BRICK for x in at], slot.shape[0]), _on_grid([x % BRICK for x in at], BRICK)
    row = slot.reshape(-1).index_select(0, brick).long()
    c = coef.reshape(-1).index_select(0, row.clamp(min=0) * BRICK**3 + place) * (row >= 0)
    return contract_torch(c.reshape(-1, 3, 3, 3), w, d, e, hessian)


def sample_bricks(bricks: Bricks, points: Tensor, hessian: bool = False) -> Tensor:
    """Value and derivatives of the spline at points [n, 3] in [-1, 1]: as `bspline.Spline.sample`.

    Differentiable with respect to the coefficients.
    """
    coef, points = at_least_float32(bricks.coefficients, points)
    if coef.device.type == "cpu":
        return _Sample.apply(coef, bricks.slot, bricks.cells, points.contiguous(), 10 if hessian else 4)
    return sample_bricks_torch(bricks._replace(coefficients=coef), points, hessian)
