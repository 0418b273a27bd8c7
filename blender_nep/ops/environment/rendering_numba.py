"""Volume rendering of the environment field on the CPU, with fused Numba kernels.

The forward kernel marches every ray once. For each sample that is not skipped, it records the cell, the weights and the
local derivatives. The backward kernels compute the gradients of the raw grid from these records, without a second march.
Results do not depend on the number of threads: rays are independent, and no two threads add to the same grid rows.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import torch
from numba import prange
from torch import Tensor

from blender_nep.ops.compilation import kernel
from blender_nep.ops.environment.contracted_rays import contraction_border, far_share, place_on_ray
from blender_nep.ops.environment.samples import Medium, RaySamples
from blender_nep.ops.environment.spherical_grid import (
    COLOR_LIMIT,
    bilinear_2d,
    bilinear_weights,
    cell,
    cell_columns,
    polar,
    trilinear,
)


class SampleRecords(NamedTuple):
    """Records of the samples for the backward pass.

    There are m places. Ray i has the places offsets[i] to offsets[i + 1] - 1, and uses the first kept[i] of them.
    """

    offsets: np.ndarray
    """[n + 1] int64"""
    kept: np.ndarray
    """[n] int64"""
    cells: np.ndarray
    """[m, 3] int32: shell, row + 1, column, as `angular_cell` returns them"""
    scattered: np.ndarray
    """[m, 8]: what a sample adds to its nodes, side by side in memory. The first three in 0..1 are the place of the sample
    between the cell's first shell, row and column and the next ones. The fourth is `far_share`: where it is 0, the sample
    has no color detail. The last four are the gradients of the raw values. The backward pass fills them"""
    detail_cells: np.ndarray
    """[m, 2] int32: row + 1 and column of the cell in the color detail"""
    detail_fractions: np.ndarray
    """[m, 2] in 0..1: place of the sample between the first row and column of that cell and the next ones"""
    local: np.ndarray
    """[m, 9]: d optical depth / d raw density, opacity, transmittance before the sample, radiance (3), gradient scale, place
    on the ray from its start, width of its step; the last two in units of the contracted length from |x| = 1 to infinity"""


@kernel(inline="always", fastmath=True, error_model="numpy")
def _radiance(raw):
    """Linear radiance of a raw color."""
    return math.exp(min(max(raw, -COLOR_LIMIT), COLOR_LIMIT))


@kernel(inline="always", fastmath=True, error_model="numpy")
def _detail_at(detail, place, share):
    """The three logarithms that the color detail adds in a cell; `place` is that of `cell`, `share` that of `far_share`."""
    red, green, blue = 0.0, 0.0, 0.0
    if share > 0.0:
        j, c, fj, fc = place
        corners, weights = cell_columns(j, c, detail.shape[0], detail.shape[1]), bilinear_weights(fj, fc)
        red = share * bilinear_2d(detail, corners, weights, 0)
        green = share * bilinear_2d(detail, corners, weights, 1)
        blue = share * bilinear_2d(detail, corners, weights, 2)
    return red, green, blue


@kernel(fastmath=True, error_model="numpy")
def _march_ray(i, raw, detail, rays, medium, rendered, records, keep):
    """What `_march` does with ray i."""
    origins, directions, t_closest, b, w_near, w_length, infinite, offsets, jitter = rays
    contraction_radius, density_gain, gradient_near, transmittance_limit, depth_limit = medium
    cells, scattered, local = records.cells, records.scattered, records.local
    detail_cells, detail_fractions = records.detail_cells, records.detail_fractions
    shells, rows, columns = raw.shape[0], raw.shape[1], raw.shape[2]
    length = math.log(contraction_radius) + 1.0
    spacing = length / (shells - 1)
    to_shell = 1.0 / spacing
    border = math.log(contraction_radius) * to_shell
    detailed = detail.shape[0] > 0
    ox, oy, oz = float(origins[i, 0]), float(origins[i, 1]), float(origins[i, 2])
    dx, dy, dz = float(directions[i, 0]), float(directions[i, 1]), float(directions[i, 2])
    first = offsets[i]
    samples = offsets[i + 1] - first
    red, green, blue, passed, count = 0.0, 0.0, 0.0, 1.0, 0
    distortion, sum_weights, sum_places = 0.0, 0.0, 0.0
    steps = samples - 1 if infinite[i] else samples
    step = w_length[i] / steps if steps > 0 else 0.0
    ray_border = contraction_border(b[i], contraction_radius)
    w = w_near[i] + jitter[i] * step
    exp_w, growth = math.exp(w), math.exp(step)
    for n in range(samples):
        closing = n == steps
        if closing:  # the sky lies at infinity, in the direction of the ray
            t = 1e30
            k_real = shells - 1.0
            px, py, pz = dx, dy, dz
        else:
            t, k_real = place_on_ray(w, exp_w, b[i], ray_border, contraction_radius, to_shell)
            t += t_closest[i]
            k_real = min(max(k_real, 0.0), shells - 1.0)
            px, py, pz = ox + t * dx, oy + t * dy, oz + t * dz
            w += step
            exp_w *= growth
        k = min(int(k_real), shells - 2)
        turn, fall = polar(px, py, pz)
        j, c, fj, fc = cell(turn, fall, rows, columns)
        fk = k_real - k
        shell_weights = 1.0 - fk, fk
        corners, weights = cell_columns(j, c, rows, columns), bilinear_weights(fj, fc)
        slope, alpha = 0.0, 1.0
        if not closing:
            value = trilinear(raw, k, shell_weights, corners, weights, 0)
            q = math.exp(-abs(value))
            density = density_gain * (max(value, 0.0) + math.log1p(q))
            depth = density * step
            if depth < depth_limit:
                continue
            slope = density_gain * step * (1.0 / (1.0 + q) if value >= 0.0 else q / (1.0 + q))
            alpha = -math.expm1(-depth)
        weight = passed * alpha
        on_ray = (w_length[i] if closing else (n + jitter[i]) * step) / length
        width = 0.0 if closing else step / length
        distortion += 2.0 * weight * (on_ray * sum_weights - sum_places) + weight * weight * width / 3.0
        sum_weights, sum_places = sum_weights + weight, sum_places + weight * on_ray
        m = first + count
        share = far_share(k_real, border, spacing) if detailed else 0.0
        place = cell(turn, fall, detail.shape[0], detail.shape[1])
        red_here, green_here, blue_here = _detail_at(detail, place, share)
        red_here = _radiance(trilinear(raw, k, shell_weights, corners, weights, 1) + red_here)
        green_here = _radiance(trilinear(raw, k, shell_weights, corners, weights, 2) + green_here)
        blue_here = _radiance(trilinear(raw, k, shell_weights, corners, weights, 3) + blue_here)
        red, green, blue = red + weight * red_here, green + weight * green_here, blue + weight * blue_here
        if keep:
            cells[m, 0], cells[m, 1], cells[m, 2] = k, j, c
            scattered[m, 0], scattered[m, 1], scattered[m, 2], scattered[m, 3] = fk, fj, fc, share
            if share > 0.0:
                detail_cells[m, 0], detail_cells[m, 1] = place[0], place[1]
                detail_fractions[m, 0], detail_fractions[m, 1] = place[2], place[3]
            local[m, 0], local[m, 1], local[m, 2] = slope, alpha, passed
            local[m, 3], local[m, 4], local[m, 5] = red_here, green_here, blue_here
            local[m, 6] = (t / gradient_near) ** 2 if t < gradient_near else 1.0
            local[m, 7], local[m, 8] = on_ray, width
            count += 1
        passed *= 1.0 - alpha
        if passed <= transmittance_limit:
            break
    rendered[i, 0], rendered[i, 1], rendered[i, 2] = red, green, blue
    rendered[i, 3], rendered[i, 4] = passed, distortion
    records.kept[i] = count


@kernel(parallel=True, fastmath=True, error_model="numpy")
def _march(raw, detail, rays, medium, rendered, records, keep):
    """Composite every ray front to back into `rendered`. With `keep`, also fill the records.

    raw [K, H, W, 4]; detail [D, 2 D, 3], D may be 0; RaySamples, Medium and SampleRecords are of NumPy arrays. `rendered`
    [n, 5] gets the radiance, the transmittance and the distortion.

    The loop only calls a function, because Numba would compile a longer body twice. It would also compile the function
    twice, for an int64 and a uint64, if the loop's index were not made an int64.
    """
    for i in prange(rays.origins.shape[0]):
        _march_ray(np.int64(i), raw, detail, rays, medium, rendered, records, keep)


@kernel(parallel=True, fastmath=True, error_model="numpy")
def _sample_gradients(records, rendered, g_rendered, scattered, used):
    """Fill the gradients of the raw values at every kept sample into `records.scattered`, which is given once more:
    Numba loses what a parallel loop writes to an array that was taken from a tuple. `used` [m] marks the places that are
    filled.

    `rendered` [n, 5] is what `_march` has made, g_rendered [n, 5] its gradient. The distortion is a sum over samples, too:
    its derivative by a sample's weight plays the part of the sample's color.
    """
    offsets, kept, local = records.offsets, records.kept, records.local
    for i in prange(kept.shape[0]):
        first = offsets[i]
        behind_r, behind_g, behind_b = float(rendered[i, 0]), float(rendered[i, 1]), float(rendered[i, 2])
        gr, gg, gb = float(g_rendered[i, 0]), float(g_rendered[i, 1]), float(g_rendered[i, 2])
        g_t, g_d = float(g_rendered[i, 3]) * float(rendered[i, 3]), float(g_rendered[i, 4])
        if gr == 0.0 and gg == 0.0 and gb == 0.0 and g_t == 0.0 and g_d == 0.0:
            continue
        sum_weights, sum_places = 0.0, 0.0  # those of the samples behind the present one, minus those in front of it
        for m in range(first, first + kept[i]):
            weight = float(local[m, 2]) * float(local[m, 1])
            sum_weights, sum_places = sum_weights + weight, sum_places + weight * float(local[m, 7])
        # the sum of weight times slope: the distortion is a sum of products of two weights, so this is twice its value
        behind_d = 2.0 * float(rendered[i, 4])
        for m in range(first, first + kept[i]):
            alpha, passed, scale = float(local[m, 1]), float(local[m, 2]), float(local[m, 6])
            red, green, blue = float(local[m, 3]), float(local[m, 4]), float(local[m, 5])
            on_ray, width = float(local[m, 7]), float(local[m, 8])
            weight = passed * alpha
            sum_weights, sum_places = sum_weights - weight, sum_places - weight * on_ray
            slope = 2.0 * (sum_places - on_ray * sum_weights) + 2.0 / 3.0 * weight * width
            sum_weights, sum_places = sum_weights - weight, sum_places - weight * on_ray
            behind_r -= weight * red
            behind_g -= weight * green
            behind_b -= weight * blue
            behind_d -= weight * slope
            rest = passed * (1.0 - alpha)
            g_depth = gr * (rest * red - behind_r) + gg * (rest * green - behind_g) - g_t
            g_depth += gb * (rest * blue - behind_b) + g_d * (rest * slope - behind_d)
            scattered[m, 4] = scale * g_depth * local[m, 0]
            scattered[m, 5] = scale * gr * weight * red
            scattered[m, 6] = scale * gg * weight * green
            scattered[m, 7] = scale * gb * weight * blue
            used[m] = 1


@kernel()
def _order_by_row(used, cells, rows):
    """Sort the used samples by the row of their cell (counting sort). Returns their order, and start [rows + 2].

    The samples of row j are order[start[j]] to order[start[j + 1] - 1].
    """
    start = np.zeros(rows + 2, np.int64)
    for m in range(used.shape[0]):
        if used[m]:
            start[cells[m, 1] + 1] += 1
    for j in range(rows + 1):
        start[j + 1] += start[j]
    order = np.empty(start[rows + 1], np.int32)
    place = start.copy()
    for m in range(used.shape[0]):
        if used[m]:
            j = cells[m, 1]
            order[place[j]] = m
            place[j] += 1
    return order, start


@kernel(parallel=True, fastmath=True, error_model="numpy")
def _scatter_rows(order, start, records, g_raw, g_detail, parity):
    """Add the sample gradients to both grids for the cells in all rows of one parity.

    These cells share no rows of the raw grid, and no rows of the detail, which has at least twice as many rows.
    """
    cells, scattered = records.cells, records.scattered
    detail_cells, detail_fractions = records.detail_cells, records.detail_fractions
    rows, columns = g_raw.shape[1], g_raw.shape[2]
    for half_j in prange((rows + 2 - parity) // 2):
        j = 2 * half_j + parity
        for p in range(start[j], start[j + 1]):
            m = order[p]
            k, c = cells[m, 0], cells[m, 2]
            fk, fj, fc, share = scattered[m, 0], scattered[m, 1], scattered[m, 2], scattered[m, 3]
            top, bottom, tl, tr, bl, br = cell_columns(j, c, rows, columns)
            for side in range(2):
                g = fk if side else 1 - fk
                w0 = g * (1 - fj) * (1 - fc)
                w1 = g * (1 - fj) * fc
                w2 = g * fj * (1 - fc)
                w3 = g * fj * fc
                for channel in range(4):
                    value = scattered[m, 4 + channel]
                    g_raw[k + side, top, tl, channel] += w0 * value
                    g_raw[k + side, top, tr, channel] += w1 * value
                    g_raw[k + side, bottom, bl, channel] += w2 * value
                    g_raw[k + side, bottom, br, channel] += w3 * value
            if share == 0.0:
                continue
            corners = cell_columns(detail_cells[m, 0], detail_cells[m, 1], g_detail.shape[0], g_detail.shape[1])
            top, bottom, tl, tr, bl, br = corners
            w0, w1, w2, w3 = bilinear_weights(detail_fractions[m, 0], detail_fractions[m, 1])
            for channel in range(3):
                value = share * scattered[m, 5 + channel]
                g_detail[top, tl, channel] += w0 * value
                g_detail[top, tr, channel] += w1 * value
                g_detail[bottom, bl, channel] += w2 * value
                g_detail[bottom, br, channel] += w3 * value


class _Render(torch.autograd.Function):
    @staticmethod
    def forward(ctx, raw, detail, rays, medium):
        grid, n = raw.detach().numpy(), len(rays.origins)
        keep = any(ctx.needs_input_grad)
        arrays = RaySamples(*(part.contiguous().numpy() for part in rays))
        m = int(arrays.offsets[-1]) if keep else 0
        records = SampleRecords(
            rays.offsets.contiguous().numpy(),
            np.empty(n, np.int64),
            np.empty((m, 3), np.int32),
            np.empty((m, 8), grid.dtype),
            np.empty((m, 2), np.int32),
            np.empty((m, 2), grid.dtype),
            np.empty((m, 9), grid.dtype),
        )
        rendered = raw.new_empty((n, 5))
        _march(grid, detail.detach().numpy(), arrays, medium, rendered.numpy(), records, keep)
        ctx.shapes, ctx.records = (grid.shape, tuple(detail.shape)), records
        ctx.rendered = rendered.numpy().copy()
        return rendered

    @staticmethod
    def backward(ctx, g_rendered):
        records = ctx.records
        used = np.zeros(len(records.local), np.uint8)
        _sample_gradients(records, ctx.rendered, g_rendered.contiguous().numpy(), records.scattered, used)
        order, start = _order_by_row(used, records.cells, ctx.shapes[0][1])
        g_raw, g_detail = (np.zeros(shape, records.local.dtype) for shape in ctx.shapes)
        for parity in (0, 1):
            _scatter_rows(order, start, records, g_raw, g_detail, parity)
        return torch.from_numpy(g_raw), torch.from_numpy(g_detail), None, None


def render(raw: Tensor, detail: Tensor, rays: RaySamples, medium: Medium) -> tuple[Tensor, Tensor, Tensor]:
    """Radiance [n, 3] premultiplied, transmittance [n] and distortion [n] of sampled rays.

    It is differentiable in raw [K, H, W, 4] and detail [D, 2 D, 3], D >= 2 H or 0, and runs on the CPU.
    `environment_rendering_torch.render` is the same function in plain torch.
    """
    rendered = _Render.apply(raw, detail, rays, medium)
    return rendered[:, :3], rendered[:, 3], rendered[:, 4]
