"""Volume rendering of the environment field in plain torch: the body for `cuda`, and the reference for the tests."""

from __future__ import annotations

import math

import torch

from blender_nep.ops.environment_rendering_numba import COLOR_LIMIT


def interpolate(raw: torch.Tensor, points: torch.Tensor, log_radius: float) -> torch.Tensor:
    """Trilinear interpolation of a spherical grid.

    Args:
        raw: [K, H, W, C]: shells at equal steps of log |x| in [0, log_radius], cell-centred rows from +z to -z, columns
            with atan2(y, x), periodic.
        points: [..., 3].

    Returns:
        [..., C].
    """
    shells, rows, columns, channels = raw.shape
    x, y, z = points.unbind(-1)
    radius = points.norm(dim=-1)
    k_real = (radius.clamp_min(1e-12).log() * ((shells - 1) / log_radius)).clamp(0.0, shells - 1.0)
    k = k_real.floor().long().clamp_max(shells - 2)
    v = torch.atan2(torch.hypot(x, y), z) * (rows / math.pi) + 0.5
    j = v.floor().long().clamp(0, rows)
    u = (torch.atan2(y, x) * (0.5 / math.pi) + 0.5) * columns + (columns - 0.5)
    c = u.floor().long()
    fk, fj, fc = (k_real - k).to(raw.dtype), (v - j).to(raw.dtype), (u - c).to(raw.dtype)
    flat = raw.reshape(-1, channels)
    result = torch.zeros((*points.shape[:-1], channels), dtype=raw.dtype, device=raw.device)
    for row, row_weight in ((j - 1, 1 - fj), (j, fj)):
        across_pole = (row < 0) | (row >= rows)
        inside = row.clamp(0, rows - 1)
        for column, column_weight in ((c, 1 - fc), (c + 1, fc)):
            turned = (column + across_pole * (columns // 2)) % columns
            for shell, shell_weight in ((k, 1 - fk), (k + 1, fk)):
                weight = row_weight * column_weight * shell_weight
                result = result + weight[..., None] * flat[(shell * rows + inside) * columns + turned]
    return result


def render(
    raw: torch.Tensor,
    origins: torch.Tensor,
    directions: torch.Tensor,
    t_closest: torch.Tensor,
    b: torch.Tensor,
    s_near: torch.Tensor,
    s_length: torch.Tensor,
    offsets: torch.Tensor,
    jitter: torch.Tensor,
    infinite: torch.Tensor,
    log_radius: float,
    density_gain: float,
    gradient_near: float,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Same arguments and result as the Numba kernels (see `environment_rendering_numba.march`), by autograd.

    Returns:
        radiance [n, 3], transmittance [n].
    """
    steps = offsets[1:] - offsets[:-1]
    slots = steps - infinite.long()
    longest = max(int(slots.max()) if len(slots) else 0, 1)
    number = torch.arange(longest, device=raw.device)
    step = s_length / slots.clamp_min(1)
    s = s_near[:, None] + (number + jitter[:, None].double()) * step[:, None]
    inside = number < slots[:, None]
    t = t_closest[:, None] + b[:, None] * torch.sinh(s)
    values = _values(raw, origins, directions, t, gradient_near, log_radius)
    depth = density_gain * torch.nn.functional.softplus(values[..., 0]) * step[:, None].to(raw.dtype) * inside
    before = torch.exp(-(depth.cumsum(1) - depth))
    weight = -torch.expm1(-depth) * before
    color = _color(values)
    radiance = (weight[..., None] * color).sum(1)
    transmittance = torch.exp(-depth.sum(1))
    t_exit = t_closest + b * torch.sinh(s_near + s_length)
    sky = _values(raw, origins, directions, t_exit[:, None], gradient_near, log_radius)[:, 0]
    radiance = radiance + (infinite * transmittance)[:, None] * _color(sky)
    return radiance, torch.where(infinite, torch.zeros_like(transmittance), transmittance)


def _color(values):
    """Radiance of raw values [..., 4]. Beyond the limit the gradient is that at the limit, as in the Numba body: with
    none, a color that has overshot would stay there."""
    raw = values[..., 1:]
    return (raw + (raw.clamp(-COLOR_LIMIT, COLOR_LIMIT) - raw).detach()).exp()


def _values(raw, origins, directions, t, gradient_near, log_radius):
    """Raw values at distances t [n, m]; gradients scaled by min(1, (t / gradient_near)^2)."""
    points = origins.double()[:, None] + t[..., None] * directions.double()[:, None]
    values = interpolate(raw, points, log_radius)
    if gradient_near <= 0.0:
        return values
    scale = ((t / gradient_near) ** 2).clamp_max(1.0).to(raw.dtype)[..., None]
    return values * scale + (values * (1 - scale)).detach()
