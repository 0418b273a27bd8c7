"""Encodings of positions and directions.

`integrated_directional_encoding` follows Ref-NeRF (Verbin et al. 2022, eq. 6-8): spherical harmonics of degrees
1, 2, 4, ..., each attenuated as under a von Mises-Fisher lobe of concentration kappa = 1 / roughness.
"""

from __future__ import annotations

import math
from functools import lru_cache

import torch


def positional_encoding(x: torch.Tensor, octaves: int) -> torch.Tensor:
    """[..., 3] -> [..., 3 + 6 * octaves]: x, then sin and cos of 2^k pi x / 2 for k = 0 .. octaves - 1."""
    if octaves == 0:
        return x
    scale = (math.pi / 2) * 2.0 ** torch.arange(octaves, dtype=x.dtype, device=x.device)
    phase = (x[..., None, :] * scale[:, None]).flatten(-2)
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


def integrated_directional_encoding(direction: torch.Tensor, kappa_inv: torch.Tensor, levels: int = 4) -> torch.Tensor:
    """Unit direction [..., 3] and kappa^-1 >= 0 [..., 1] -> [..., encoding_size(levels)].

    Powers of (x + iy) are computed by multiplication. So they are polynomials, and their gradient is finite at the poles.
    """
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
