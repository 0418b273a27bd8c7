"""Encodings of positions and directions. The bodies are Numba's on the CPU, and plain torch elsewhere.

`integrated_directional_encoding` follows Ref-NeRF (Verbin et al. 2022, eq. 6-8): spherical harmonics of degrees
1, 2, 4, ..., each attenuated as under a von Mises-Fisher lobe of concentration kappa = 1 / roughness.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import torch
from numba import prange
from torch.autograd.function import once_differentiable

from blender_nep.ops.compilation import kernel
from blender_nep.ops.precision import at_least_float32


@kernel(parallel=True, fastmath=True, error_model="numpy")
def _encode_positions(x, octaves, out):
    """Fill out [n, 3 + 6 octaves]. Each octave follows from the one before by the formulas of the double angle."""
    for i in prange(x.shape[0]):
        for axis in range(3):
            sine, cosine = np.sin(x[i, axis] * x.dtype.type(0.5 * np.pi)), np.cos(x[i, axis] * x.dtype.type(0.5 * np.pi))
            out[i, axis] = x[i, axis]
            for k in range(octaves):
                out[i, 3 + 3 * k + axis] = sine
                out[i, 3 + 3 * (octaves + k) + axis] = cosine
                sine, cosine = 2 * sine * cosine, 1 - 2 * sine * sine


@kernel(parallel=True, fastmath=True, error_model="numpy")
def _positions_backward(encoded, grad, octaves, grad_x):
    """Fill grad_x [n, 3], the adjoint of `_encode_positions`, whose result is `encoded`."""
    for i in prange(encoded.shape[0]):
        for axis in range(3):
            total, scale = grad[i, axis], encoded.dtype.type(0.5 * np.pi)
            for k in range(octaves):
                a, b = 3 + 3 * k + axis, 3 + 3 * (octaves + k) + axis
                total += scale * (grad[i, a] * encoded[i, b] - grad[i, b] * encoded[i, a])
                scale *= 2
            grad_x[i, axis] = total


class _Positions(torch.autograd.Function):
    @staticmethod
    def forward(ctx, x, octaves):
        out = x.new_empty(len(x), 3 + 6 * octaves)
        _encode_positions(x.detach().numpy(), octaves, out.numpy())
        ctx.save_for_backward(out)
        ctx.octaves = octaves
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx, grad):
        (out,) = ctx.saved_tensors
        grad_x = grad.new_empty(len(grad), 3)
        _positions_backward(out.detach().numpy(), grad.contiguous().numpy(), ctx.octaves, grad_x.numpy())
        return grad_x, None


def positional_encoding(x: torch.Tensor, octaves: int, body: str = "auto") -> torch.Tensor:
    """[n, 3] -> [n, 3 + 6 octaves]: x, then sin and cos of 2^k pi x / 2 for k = 0 .. octaves - 1.

    body: "auto" (Numba on the CPU, torch elsewhere), "numba" or "torch". Only that of torch can be differentiated twice.
    """
    (x,) = at_least_float32(x)
    if octaves == 0:
        return x
    if body == "numba" or (body == "auto" and x.device.type == "cpu"):
        return _Positions.apply(x, octaves)
    scale = (math.pi / 2) * 2.0 ** torch.arange(octaves, dtype=x.dtype, device=x.device)
    phase = (x[:, None, :] * scale[:, None]).flatten(-2)
    return torch.cat([x, phase.sin(), phase.cos()], -1)


@lru_cache(maxsize=8)
def _legendre_table(levels: int) -> tuple[list[tuple[int, int]], torch.Tensor]:
    """The (l, m) pairs, and the float64 coefficients [pairs, l_max + 1] of z^k in Y_l^m / (x + iy)^m."""
    pairs = [(2**i, m) for i in range(levels) for m in range(2**i + 1)]
    table = torch.zeros(len(pairs), 2 ** (levels - 1) + 1, dtype=torch.float64)
    for row, (degree, m) in enumerate(pairs):
        norm = math.sqrt((2 * degree + 1) * math.factorial(degree - m) / (4 * math.pi * math.factorial(degree + m)))
        for k in range(degree - m + 1):
            half = 0.5 * (degree + k + m - 1.0)
            binomial = math.prod(half - j for j in range(degree)) / math.factorial(degree)
            table[row, k] = (
                norm
                * (-1) ** m
                * 2**degree
                * math.factorial(degree)
                / math.factorial(k)
                / math.factorial(degree - k - m)
                * binomial
            )
    return pairs, table


def encoding_size(levels: int) -> int:
    """Number of channels of `integrated_directional_encoding`."""
    return 2 * sum(2**i + 1 for i in range(levels))


_LANES = 16
"""Number of directions that are encoded side by side. The loops over them become vector instructions."""


@kernel(inline="always")
def _powers(direction, first, count, top):
    """The real and imaginary parts of (x + iy)^m, and z^m, each [top + 1, _LANES], for m = 0 .. top.

    The lanes are the directions [n, 3] from `first` on. Those after `count` repeat the last one.
    """
    powers = np.empty((3, top + 1, _LANES), direction.dtype)
    re, im, z_power = powers[0], powers[1], powers[2]
    for lane in range(_LANES):
        i = first + min(lane, count - 1)
        re[0, lane], im[0, lane], z_power[0, lane] = 1, 0, 1
        re[1, lane], im[1, lane], z_power[1, lane] = direction[i, 0], direction[i, 1], direction[i, 2]
    for m in range(2, re.shape[0]):
        for lane in range(_LANES):
            re[m, lane] = re[m - 1, lane] * re[1, lane] - im[m - 1, lane] * im[1, lane]
            im[m, lane] = re[m - 1, lane] * im[1, lane] + im[m - 1, lane] * re[1, lane]
            z_power[m, lane] = z_power[m - 1, lane] * z_power[1, lane]
    return re, im, z_power


@kernel(inline="always")
def _attenuations(kappa_inv, first, count, rate, attenuation):
    """Fill attenuation [_LANES] with exp(rate * kappa^-1) of the directions from `first` on."""
    for lane in range(_LANES):
        value = kappa_inv[first + min(lane, count - 1)]
        attenuation[lane] = np.exp(rate * max(value, value * 0))


@kernel(parallel=True, fastmath=True, error_model="numpy")
def _encode_directions(direction, kappa_inv, table, out):
    """Fill out [n, 2 pairs], as `integrated_directional_encoding`. table: as that of `_legendre_table`."""
    n, pairs, top = direction.shape[0], table.shape[0], table.shape[1] - 1
    for block in prange((n + _LANES - 1) // _LANES):
        first, kind = block * _LANES, direction.dtype
        count = min(_LANES, n - first)
        attenuation, value = np.empty(_LANES, kind), np.empty(_LANES, kind)
        re, im, z_power = _powers(direction, first, count, top)
        row, degree = 0, 1
        while degree <= top:
            _attenuations(kappa_inv, first, count, kind.type(-0.5 * degree * (degree + 1)), attenuation)
            for m in range(degree + 1):
                value[:] = 0
                for k in range((degree - m) % 2, degree - m + 1, 2):  # the others are 0: Legendre functions are even or odd
                    for lane in range(_LANES):
                        value[lane] += table[row, k] * z_power[k, lane]
                for lane in range(_LANES):
                    value[lane] *= attenuation[lane]
                for lane in range(count):
                    out[first + lane, row] = value[lane] * re[m, lane]
                    out[first + lane, pairs + row] = value[lane] * im[m, lane]
                row += 1
            degree *= 2


@kernel(parallel=True, fastmath=True, error_model="numpy")
def _directions_backward(direction, kappa_inv, table, grad, grads):
    """Fill grads [n, 4]: the adjoint of `_encode_directions` for the direction and kappa^-1."""
    n, pairs, top = direction.shape[0], table.shape[0], table.shape[1] - 1
    for block in prange((n + _LANES - 1) // _LANES):
        first, kind = block * _LANES, direction.dtype
        count = min(_LANES, n - first)
        attenuation, value, slope = np.empty(_LANES, kind), np.empty(_LANES, kind), np.empty(_LANES, kind)
        g_re, g_im = np.zeros(_LANES, kind), np.zeros(_LANES, kind)
        total = np.zeros((4, _LANES), kind)
        re, im, z_power = _powers(direction, first, count, top)
        row, degree = 0, 1
        while degree <= top:
            rate = kind.type(-0.5 * degree * (degree + 1))
            _attenuations(kappa_inv, first, count, rate, attenuation)
            for m in range(degree + 1):
                value[:] = 0
                slope[:] = 0
                for k in range((degree - m) % 2, degree - m + 1, 2):
                    below, factor = max(k - 1, 0), table[row, k]
                    derivative = kind.type(k) * factor
                    for lane in range(_LANES):
                        value[lane] += factor * z_power[k, lane]
                        slope[lane] += derivative * z_power[below, lane]
                for lane in range(count):
                    g_re[lane], g_im[lane] = grad[first + lane, row], grad[first + lane, pairs + row]
                below, power = max(m - 1, 0), kind.type(m)
                for lane in range(_LANES):
                    along = attenuation[lane] * (g_re[lane] * re[m, lane] + g_im[lane] * im[m, lane])
                    slant = attenuation[lane] * power * value[lane]
                    total[0, lane] += slant * (g_re[lane] * re[below, lane] + g_im[lane] * im[below, lane])
                    total[1, lane] += slant * (g_im[lane] * re[below, lane] - g_re[lane] * im[below, lane])
                    total[2, lane] += slope[lane] * along
                    total[3, lane] += rate * value[lane] * along
                row += 1
            degree *= 2
        for lane in range(count):
            for part in range(4):
                grads[first + lane, part] = total[part, lane]
            if kappa_inv[first + lane] < 0:
                grads[first + lane, 3] = 0


class _Directions(torch.autograd.Function):
    @staticmethod
    def forward(ctx, direction, kappa_inv, levels):
        out = direction.new_empty(len(direction), encoding_size(levels))
        _encode_directions(
            direction.detach().numpy(),
            kappa_inv.detach()[:, 0].numpy(),
            _legendre_table(levels)[1].to(direction.dtype).numpy(),
            out.numpy(),
        )
        ctx.save_for_backward(direction, kappa_inv)
        ctx.levels = levels
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx, grad):
        direction, kappa_inv = ctx.saved_tensors
        grads = grad.new_empty(len(grad), 4)
        _directions_backward(
            direction.detach().numpy(),
            kappa_inv.detach()[:, 0].numpy(),
            _legendre_table(ctx.levels)[1].to(direction.dtype).numpy(),
            grad.contiguous().numpy(),
            grads.numpy(),
        )
        return grads[:, :3], grads[:, 3:], None


def integrated_directional_encoding(
    direction: torch.Tensor, kappa_inv: torch.Tensor, levels: int = 4, body: str = "auto"
) -> torch.Tensor:
    """Unit direction [n, 3] and kappa^-1 >= 0 [n, 1] -> [n, encoding_size(levels)].

    Powers of (x + iy) are computed by multiplication. So they are polynomials, and their gradient is finite at the poles.
    body: "auto" (Numba on the CPU, torch elsewhere), "numba" or "torch". Only that of torch can be differentiated twice.
    """
    direction, kappa_inv = at_least_float32(direction, kappa_inv)
    kappa_inv = kappa_inv.expand(len(direction), 1)
    if body == "numba" or (body == "auto" and direction.device.type == "cpu"):
        return _Directions.apply(direction, kappa_inv, levels)
    pairs, table = _legendre_table(levels)
    table = table.to(direction)
    x, y, z = direction.unbind(-1)
    top = 2 ** (levels - 1)
    re, im = [torch.ones_like(x)], [torch.zeros_like(x)]
    for _ in range(top):
        re.append(re[-1] * x - im[-1] * y)
        im.append(re[-2] * y + im[-1] * x)
    z_power = [torch.ones_like(z)]
    for _ in range(top):
        z_power.append(z_power[-1] * z)
    polynomial = torch.stack(z_power, -1) @ table.T
    order = torch.tensor([m for _, m in pairs], device=direction.device)
    degree = torch.tensor([n * (n + 1) / 2 for n, _ in pairs], dtype=direction.dtype, device=direction.device)
    scaled = polynomial * torch.exp(-degree * kappa_inv.clamp(min=0))
    return torch.cat([scaled * torch.stack(re, -1)[..., order], scaled * torch.stack(im, -1)[..., order]], -1)
