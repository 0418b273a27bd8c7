"""Quadratic B-spline volume on [-1, 1]^3: value, gradient and Hessian at points, from 27 coefficients.

A spline with M cells along an axis has N = M + 2 coefficients along that axis. The spline is C1: normals are continuous, and
the Hessian is piecewise constant. Value, gradient and Hessian are linear in the coefficients; so no double backward pass is
needed to learn from normals. `refine` halves the cells and gives exactly the same function.

Reference: de Boor, A Practical Guide to Splines. The rule of `refine` is Chaikin's corner cutting.
"""

from __future__ import annotations

from functools import lru_cache

import numba
import numpy as np
import torch
from numba import prange

from blender_nep.ops.compilation import kernel
from blender_nep.ops.precision import at_least_float32


@kernel(inline="always")
def axis_taps(x, cells, w, dw, ddw):
    """Index of the first of three taps at x in [-1, 1]. Fills their weights w and derivatives dw, ddw with respect to x."""
    p = (x * 0.5 + 0.5) * cells
    i = int(np.floor(p))
    if i < 0:
        i = 0
    elif i > cells - 1:
        i = cells - 1
    f = p - i
    s = cells * 0.5
    w[0] = 0.5 * (1.0 - f) * (1.0 - f)
    w[1] = 0.5 + f * (1.0 - f)
    w[2] = 0.5 * f * f
    dw[0] = -(1.0 - f) * s
    dw[1] = (1.0 - 2.0 * f) * s
    dw[2] = f * s
    ddw[0] = s * s
    ddw[1] = -2.0 * s * s
    ddw[2] = s * s
    return i


@kernel(parallel=True, fastmath=True)
def _forward(coef, points, out, threads):
    cells = coef.shape[0] - 2
    n, hessian = points.shape[0], out.shape[1] == 10
    blocks = threads * 4
    for b in prange(blocks):
        w = np.empty((3, 3), coef.dtype)
        d = np.empty((3, 3), coef.dtype)
        e = np.empty((3, 3), coef.dtype)
        for k in range(b * n // blocks, (b + 1) * n // blocks):
            i = axis_taps(points[k, 0], cells, w[0], d[0], e[0])
            j = axis_taps(points[k, 1], cells, w[1], d[1], e[1])
            m = axis_taps(points[k, 2], cells, w[2], d[2], e[2])
            v = gx = gy = gz = hxx = hyy = hzz = hxy = hxz = hyz = coef[0, 0, 0] * 0
            for a in range(3):
                for c in range(3):
                    row = coef[i + a, j + c]
                    s0 = row[m] * w[2, 0] + row[m + 1] * w[2, 1] + row[m + 2] * w[2, 2]
                    s1 = row[m] * d[2, 0] + row[m + 1] * d[2, 1] + row[m + 2] * d[2, 2]
                    ww, wd, dw = w[0, a] * w[1, c], w[0, a] * d[1, c], d[0, a] * w[1, c]
                    v += ww * s0
                    gx += dw * s0
                    gy += wd * s0
                    gz += ww * s1
                    if hessian:
                        s2 = row[m] * e[2, 0] + row[m + 1] * e[2, 1] + row[m + 2] * e[2, 2]
                        hxx += e[0, a] * w[1, c] * s0
                        hyy += w[0, a] * e[1, c] * s0
                        hzz += ww * s2
                        hxy += d[0, a] * d[1, c] * s0
                        hxz += dw * s1
                        hyz += wd * s1
            out[k, 0] = v
            out[k, 1] = gx
            out[k, 2] = gy
            out[k, 3] = gz
            if hessian:
                out[k, 4] = hxx
                out[k, 5] = hyy
                out[k, 6] = hzz
                out[k, 7] = hxy
                out[k, 8] = hxz
                out[k, 9] = hyz


@kernel(inline="always")
def row_adjoint(grad, k, w, d, e, a, c, hessian):
    """What grad[k] [4 or 10] of point k gives to the row of taps (a, c): the factors of w[2], d[2] and e[2]."""
    ww, wd, dw = w[0, a] * w[1, c], w[0, a] * d[1, c], d[0, a] * w[1, c]
    a0 = grad[k, 0] * ww + grad[k, 1] * dw + grad[k, 2] * wd
    a1 = grad[k, 3] * ww
    a2 = a1 * 0
    if hessian:
        a0 += grad[k, 4] * e[0, a] * w[1, c] + grad[k, 5] * w[0, a] * e[1, c] + grad[k, 7] * d[0, a] * d[1, c]
        a1 += grad[k, 8] * dw + grad[k, 9] * wd
        a2 = grad[k, 6] * ww
    return a0, a1, a2


@kernel(parallel=True, fastmath=True)
def _backward(points, grad, coef_grad, threads):
    """Add the adjoint of `_forward` to coef_grad. Each thread has its own slab of the first axis, so threads never race."""
    size = coef_grad.shape[0]
    cells = size - 2
    n, hessian = points.shape[0], grad.shape[1] == 10
    slabs = threads
    for b in prange(slabs):
        # the object lies in the middle half: that half is cut into slabs, so that the threads share the work
        low = 0 if b == 0 else int(size * (0.25 + 0.5 * b / slabs))
        high = size if b == slabs - 1 else int(size * (0.25 + 0.5 * (b + 1) / slabs))
        w = np.empty((3, 3), coef_grad.dtype)
        d = np.empty((3, 3), coef_grad.dtype)
        e = np.empty((3, 3), coef_grad.dtype)
        for k in range(n):
            first = int(np.floor((points[k, 0] * 0.5 + 0.5) * cells))
            if first + 3 < low or first - 1 >= high:
                continue
            i = axis_taps(points[k, 0], cells, w[0], d[0], e[0])
            j = axis_taps(points[k, 1], cells, w[1], d[1], e[1])
            m = axis_taps(points[k, 2], cells, w[2], d[2], e[2])
            for a in range(3):
                if i + a < low or i + a >= high:
                    continue
                for c in range(3):
                    a0, a1, a2 = row_adjoint(grad, k, w, d, e, a, c, hessian)
                    for q in range(3):
                        coef_grad[i + a, j + c, m + q] += a0 * w[2, q] + a1 * d[2, q] + a2 * e[2, q]


class _Gradient:
    """The gradient of a spline's coefficients, to which several samples add."""

    def __init__(self) -> None:
        self.sum: torch.Tensor | None = None

    def add(self, points: torch.Tensor, grad: torch.Tensor, shape: torch.Size) -> None:
        """Add the adjoint of `_forward` at points [n, 3] for grad [n, 4 or 10]."""
        if self.sum is None:
            self.sum = grad.new_zeros(shape)
        _backward(points.numpy(), grad.contiguous().numpy(), self.sum.numpy(), numba.get_num_threads())


class _Share(torch.autograd.Function):
    """A number on which all samples depend. So autograd runs its backward after theirs. By then, the sum is complete."""

    @staticmethod
    def forward(ctx, coef, gradient):
        ctx.gradient = gradient
        return coef.new_zeros(())

    @staticmethod
    def backward(ctx, grad):
        total, ctx.gradient.sum = ctx.gradient.sum, None
        return total, None


class _Sample(torch.autograd.Function):
    @staticmethod
    def forward(ctx, share, coef, gradient, points, channels):
        out = torch.empty(points.shape[0], channels, dtype=coef.dtype)
        _forward(coef.numpy(), points.numpy(), out.numpy(), numba.get_num_threads())
        ctx.save_for_backward(points)
        ctx.gradient, ctx.shape = gradient, coef.shape
        return out

    @staticmethod
    def backward(ctx, grad):
        ctx.gradient.add(*ctx.saved_tensors, grad, ctx.shape)
        return grad.new_zeros(()), None, None, None, None


_ORDERS = ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1), (2, 0, 0), (0, 2, 0), (0, 0, 2), (1, 1, 0), (1, 0, 1), (0, 1, 1))
"""The orders of the derivatives in x, y and z that `Spline.sample` returns."""


def taps_torch(points: torch.Tensor, cells: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """For points [n, 3]: the first of three taps along each axis [n, 3] int64, and their weights [n, 3, 3], with the first
    and second derivatives of the weights. The last axis is the tap."""
    p = (points * 0.5 + 0.5) * cells
    i = p.detach().floor().clamp(0, cells - 1).nan_to_num(0)  # a NaN cannot be an index; the weights keep it
    f = p - i
    s = cells * 0.5
    w = torch.stack([0.5 * (1 - f) ** 2, 0.5 + f * (1 - f), 0.5 * f * f], -1)
    d = torch.stack([-(1 - f), 1 - 2 * f, f], -1) * s
    e = torch.tensor([1.0, -2.0, 1.0], dtype=points.dtype, device=points.device).expand_as(w) * s * s
    return i.long(), w, d, e


def contract_torch(c: torch.Tensor, w: torch.Tensor, d: torch.Tensor, e: torch.Tensor, hessian: bool) -> torch.Tensor:
    """Value and derivatives [n, 4 or 10] from the 27 coefficients [n, 3, 3, 3] and the weights of `taps_torch`.

    The axes are contracted one after the other, z first, each with the weights of all orders of derivative.
    """
    n = len(c)
    orders = torch.stack([w, d, e] if hessian else [w, d], -2)  # [n, axis, order, tap]
    k = orders.shape[2]
    along_z = c.reshape(n, 9, 3) @ orders[:, 2].mT  # [n, x y, order in z]
    along_y = orders[:, 1, None] @ along_z.reshape(n, 3, 3, k)  # [n, x, order in y, order in z]
    all_orders = orders[:, 0] @ along_y.reshape(n, 3, k * k)
    return all_orders.reshape(n, k**3).index_select(1, _wanted_orders(k, c.device))


@lru_cache
def _wanted_orders(k: int, device: torch.device) -> torch.Tensor:
    """The places of `_ORDERS` in the flat list of k^3 orders."""
    wanted = _ORDERS if k == 3 else _ORDERS[:4]
    return torch.tensor([(x * k + y) * k + z for x, y, z in wanted], device=device)


def sample_torch(coef: torch.Tensor, points: torch.Tensor, hessian: bool = False) -> torch.Tensor:
    """The body of `Spline.sample` in plain torch, for any device and any float type."""
    i, w, d, e = taps_torch(points, coef.shape[0] - 2)
    tap = torch.arange(3, device=coef.device)
    x, y, z = (i[:, a, None] + tap for a in range(3))
    row = (x[:, :, None] * coef.shape[1] + y[:, None, :])[..., None] * coef.shape[2]
    # the gradient of index_select adds up without sorting the indices, unlike that of coef[x, y, z]
    c = coef.reshape(-1).index_select(0, (row + z[:, None, None, :]).reshape(-1))
    return contract_torch(c.reshape(-1, 3, 3, 3), w, d, e, hessian)


class Spline:
    """A spline with coefficients [N, N, N]. All its samples add to one gradient of the coefficients.

    Without that, each call would make a gradient of its own, and autograd would add them up. Each of
    these is a pass over all coefficients, although the points touch few of them. A spline that is made where gradients are
    disabled has none.
    """

    def __init__(self, coef: torch.Tensor) -> None:
        (self._coef,) = at_least_float32(coef)
        self._gradient = _Gradient()
        self._share = _Share.apply(self._coef, self._gradient) if self._coef.device.type == "cpu" else None

    def sample(self, points: torch.Tensor, hessian: bool = False) -> torch.Tensor:
        """Value and derivatives of the spline at points [n, 3] in [-1, 1], which get no gradient.

        Returns [n, 4]: value, d/dx, d/dy, d/dz; with `hessian` [n, 10]: also xx, yy, zz, xy, xz, yz. Differentiable with
        respect to the coefficients.
        """
        (points,) = at_least_float32(points.detach())
        if self._share is None:
            return sample_torch(self._coef, points, hessian)
        channels = 10 if hessian else 4
        return _Sample.apply(self._share, self._coef.detach(), self._gradient, points.contiguous(), channels)


@kernel(parallel=True, fastmath=True)
def _refine(coef, level, fine):
    """Chaikin's rule along three axes: each block of 2^3 neighboring coefficients gives 2^3 finer ones.

    `level` is as large as `fine`, and is added to it. Or it has no entries; then nothing is added.
    """
    adds = level.shape[0] > 0
    n0, n1, n2 = coef.shape[0] - 1, coef.shape[1] - 1, coef.shape[2] - 1
    for i in prange(n0):
        # `row` is a row of `coef` after the rule along x and y; there is one for each of the four finer rows
        row = np.empty(n2 + 1, coef.dtype)
        for j in range(n1):
            for a in range(2):
                wa = 0.25 + 0.5 * a
                for b in range(2):
                    wb = 0.25 + 0.5 * b
                    for k in range(n2 + 1):
                        row[k] = (1 - wa) * ((1 - wb) * coef[i, j, k] + wb * coef[i, j + 1, k]) + wa * (
                            (1 - wb) * coef[i + 1, j, k] + wb * coef[i + 1, j + 1, k]
                        )
                    out = fine[2 * i + a, 2 * j + b]
                    for k in range(n2):
                        out[2 * k] = 0.75 * row[k] + 0.25 * row[k + 1]
                        out[2 * k + 1] = 0.25 * row[k] + 0.75 * row[k + 1]
                    if adds:
                        more = level[2 * i + a, 2 * j + b]
                        for k in range(2 * n2):
                            out[k] += more[k]


@kernel(parallel=True, fastmath=True)
def _refine_adjoint(grad, coef_grad):
    """The transpose of `_refine`: every coarse coefficient sums over 4^3 finer ones."""
    weight = np.array([0.25, 0.75, 0.75, 0.25], grad.dtype)
    for i in prange(coef_grad.shape[0]):
        row = np.empty(grad.shape[2] + 4, grad.dtype)  # with two zeros at each end
        for j in range(coef_grad.shape[1]):
            row[:] = 0
            for a in range(4):
                x = 2 * i - 2 + a
                if x < 0 or x >= grad.shape[0]:
                    continue
                for b in range(4):
                    y = 2 * j - 2 + b
                    if y < 0 or y >= grad.shape[1]:
                        continue
                    w = weight[a] * weight[b]
                    source = grad[x, y]
                    for k in range(grad.shape[2]):
                        row[k + 2] += w * source[k]
            for k in range(coef_grad.shape[2]):
                coef_grad[i, j, k] = weight[0] * (row[2 * k] + row[2 * k + 3]) + weight[1] * (
                    row[2 * k + 1] + row[2 * k + 2]
                )


class _Refine(torch.autograd.Function):
    @staticmethod
    def forward(ctx, coef, level):
        fine = coef.new_empty([2 * n - 2 for n in coef.shape])
        plus = coef.new_empty(0, 0, 0) if level is None else level
        _refine(coef.detach().contiguous().numpy(), plus.detach().contiguous().numpy(), fine.numpy())
        ctx.shape = coef.shape
        return fine

    @staticmethod
    def backward(ctx, grad):
        coef_grad = grad.new_empty(ctx.shape)
        _refine_adjoint(grad.contiguous().numpy(), coef_grad.numpy())
        return coef_grad, grad if ctx.needs_input_grad[1] else None


def refine_torch(coef: torch.Tensor) -> torch.Tensor:
    """The body of `refine` in plain torch, for any device and any float type."""
    for axis in range(3):
        n = coef.shape[axis]
        low, high = coef.narrow(axis, 0, n - 1), coef.narrow(axis, 1, n - 1)
        pair = torch.stack([torch.lerp(low, high, 0.25), torch.lerp(low, high, 0.75)], axis + 1)
        coef = pair.flatten(axis, axis + 1)
    return coef


def refine(coef: torch.Tensor, level: torch.Tensor | None = None) -> torch.Tensor:
    """Coefficients of exactly the same spline on cells half as wide: [N, N, N] -> [2N - 2, 2N - 2, 2N - 2].

    If a finer `level` [2N - 2, 2N - 2, 2N - 2] is given, it is added to the result. Linear and differentiable. Raises
    ValueError for a level of another size or type.
    """
    coef, *levels = at_least_float32(*((coef,) if level is None else (coef, level)))
    for other in levels:
        if other.dtype != coef.dtype or list(other.shape) != [2 * n - 2 for n in coef.shape]:
            finer = tuple(2 * n - 2 for n in coef.shape)
            raise ValueError(f"a level must be {coef.dtype} {finer}, not {other.dtype} {tuple(other.shape)}")
    if coef.device.type == "cpu":
        return _Refine.apply(coef, *(levels or (None,)))
    return sum(levels, refine_torch(coef))
