"""Volume rendering of the environment field in plain torch, for `cuda`, and as the reference in tests."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from blender_nep.ops.environment.contracted_rays import SMALLEST_ANGLE
from blender_nep.ops.environment.samples import Medium, RaySamples
from blender_nep.ops.environment.segments import contracted_length, far_share
from blender_nep.ops.environment.spherical_grid import COLOR_LIMIT


def interpolate(raw: Tensor, points: Tensor, shell: Tensor) -> Tensor:
    """Trilinear interpolation of a spherical grid.

    Args:
        raw: [K, H, W, C]: K shells, cell-centered rows from +z to -z, columns with atan2(y, x), periodic.
        points: [..., 3]; only their directions from the origin count.
        shell: [...] in 0 .. K - 1: the place between the shells.

    Returns:
        [..., C].
    """
    shells, rows, columns, channels = raw.shape
    x, y, z = points.unbind(-1)
    k_real = shell.clamp(0.0, shells - 1.0)
    k = k_real.floor().long().clamp(0, shells - 2)  # below 0 for a NaN
    v = torch.atan2(torch.hypot(x, y), z) * (rows / math.pi) + 0.5
    j = v.floor().long().clamp(0, rows)
    u = (torch.atan2(y, x) * (0.5 / math.pi) + 0.5) * columns + (columns - 0.5)
    c = u.floor().long()
    fk, fj, fc = (k_real - k).to(raw.dtype), (v - j).to(raw.dtype), (u - c).to(raw.dtype)
    places, weights = [], []
    for row, row_weight in ((j - 1, 1 - fj), (j, fj)):
        across_pole = (row < 0) | (row >= rows)
        inside = row.clamp(0, rows - 1)
        for column, column_weight in ((c, 1 - fc), (c + 1, fc)):
            turned = (column + across_pole * (columns // 2)) % columns
            for shell, shell_weight in ((k, 1 - fk), (k + 1, fk)):
                places.append((shell * rows + inside) * columns + turned)
                weights.append(row_weight * column_weight * shell_weight)
    # the gradient of index_select adds up without sorting the indices
    nodes = raw.reshape(-1, channels).index_select(0, torch.stack(places).reshape(-1))
    weight = torch.stack(weights)
    return (nodes.reshape(*weight.shape, channels) * weight[..., None]).sum(0)


def render(raw: Tensor, detail: Tensor, rays: RaySamples, medium: Medium) -> tuple[Tensor, Tensor, Tensor]:
    """The same as `environment_rendering_numba.render`, by autograd. No rays are ended early.

    Returns:
        radiance [n, 3] premultiplied, transmittance [n], distortion [n].
    """
    steps = rays.offsets[1:] - rays.offsets[:-1] - rays.infinite.long()
    longest = max(int(steps.max()) if len(steps) else 0, 1)
    number = torch.arange(longest, device=raw.device)
    step = rays.w_length / steps.clamp_min(1)
    w = rays.w_near[:, None] + (number + rays.jitter[:, None].double()) * step[:, None]
    inside = number < steps[:, None]
    t, shell = _places(w, rays.b[:, None], raw.shape[0], medium.contraction_radius)
    t = t + rays.t_closest[:, None]
    points = rays.origins.double()[:, None] + t[..., None] * rays.directions.double()[:, None]
    values = _values(raw, detail, points, shell, medium.contraction_radius)
    if medium.gradient_near > 0.0:
        scale = ((t / medium.gradient_near) ** 2).clamp_max(1.0).to(raw.dtype)[..., None]
        values = values * scale + (values * (1 - scale)).detach()
    depth = medium.density_gain * torch.nn.functional.softplus(values[..., 0]) * step[:, None].to(raw.dtype) * inside
    depth = depth * (depth >= medium.depth_limit)
    before = torch.exp(-(depth.cumsum(1) - depth))
    weight = -torch.expm1(-depth) * before
    color = _color(values)
    radiance = (weight[..., None] * color).sum(1)
    transmittance = torch.exp(-depth.sum(1))
    directions = rays.directions.double()  # the sky lies at infinity, in the direction of the ray
    last = torch.full_like(directions[:, 0], raw.shape[0] - 1.0)
    sky = _values(raw, detail, directions, last, medium.contraction_radius)
    radiance = radiance + (rays.infinite * transmittance)[:, None] * _color(sky)
    length = contracted_length(medium.contraction_radius)
    on_ray = (torch.cat([w - rays.w_near[:, None], rays.w_length[:, None]], 1) / length).to(raw.dtype)
    distortion = _distortion(
        torch.cat([weight, (rays.infinite * transmittance)[:, None]], 1),
        on_ray,
        torch.nn.functional.pad((step[:, None] / length).to(raw.dtype).expand_as(weight), (0, 1)),
    )
    return radiance, torch.where(rays.infinite, torch.zeros_like(transmittance), transmittance), distortion


def _distortion(weight: Tensor, place: Tensor, width: Tensor) -> Tensor:
    """The distortion [n] of m samples on each of n rays: eq. 15 of mip-NeRF 360 (Barron et al. 2022), by running sums.

    Weights [n, m], places on the ray, which rise, and widths of the steps; places and widths in the same unit.
    """
    before, places = weight.cumsum(1) - weight, (weight * place).cumsum(1) - weight * place
    return (2 * weight * (place * before - places) + weight**2 * width / 3).sum(1)


def _color(values):
    """Radiance [..., 3] of raw values [..., 4].

    Beyond COLOR_LIMIT the gradient is that at the limit, as in the Numba body. Without a gradient, a color beyond the limit
    would stay there.
    """
    raw = values[..., 1:]
    return (raw + (raw.clamp(-COLOR_LIMIT, COLOR_LIMIT) - raw).detach()).exp()


def _values(raw: Tensor, detail: Tensor, points: Tensor, shell: Tensor, contraction_radius: float) -> Tensor:
    """Raw values [..., 4] at points [..., 3] between the shells [...], with the color detail [D, 2 D, 3] of far points."""
    values = interpolate(raw, points, shell)
    if not len(detail):
        return values
    u = shell * (contracted_length(contraction_radius) / (raw.shape[0] - 1))
    share = far_share(u, contraction_radius).to(raw.dtype)
    fine = interpolate(detail[None].expand(2, -1, -1, -1), points, torch.zeros_like(shell))
    return values + torch.nn.functional.pad(share[..., None] * fine, (1, 0))


def _places(w: Tensor, b: Tensor, shells: int, contraction_radius: float) -> tuple[Tensor, Tensor]:
    """Signed distances [n, m] from the rays' closest points, and places between the shells [n, m], at w [n, m].

    b [n, 1] are the distances of the closest points from the origin.
    """
    border = (b / contraction_radius).clamp_max(1)
    w_border, z_border = torch.acosh(1 / border), torch.asin(border)
    inner = w.clamp(-w_border, w_border)
    z = (z_border - (w.abs() - w_border) * b / contraction_radius).clamp(SMALLEST_ANGLE, 0.5 * math.pi)
    is_inner = w.abs() <= w_border
    t = torch.where(is_inner, b * torch.sinh(inner), torch.sign(w) * b / torch.tan(z))
    beyond = contracted_length(contraction_radius) - contraction_radius * torch.sin(z) / b
    u = torch.where(is_inner, torch.log(b * torch.cosh(inner)), beyond)
    return t, u * ((shells - 1) / contracted_length(contraction_radius))
