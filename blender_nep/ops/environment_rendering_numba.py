"""Volume rendering of the environment field on the CPU: fused Numba kernels.

The forward kernel marches every ray once and keeps, for each sample that matters, the cell, the weights and the local
derivatives. The backward kernels turn these into gradients of the raw grid without a second march. Results do not
depend on the number of threads: rays are independent, and the gradient is scattered by bands of grid rows that no two
threads share.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

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
    """The two rows of a cell, and for each its two columns (shifted by half a turn across a pole)."""
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


@njit(cache=True, parallel=True, fastmath=True, error_model="numpy")
def march(
    raw,
    origins,
    directions,
    t_closest,
    b,
    s_near,
    s_length,
    offsets,
    jitter,
    infinite,
    log_radius,
    density_gain,
    gradient_near,
    transmittance_limit,
    depth_limit,
    keep,
    radiance,
    transmittance,
    live,
    cells,
    fractions,
    local,
):
    """Composite every ray front to back.

    Args:
        raw: [K, H, W, 4] grid: raw density, logarithm of radiance.
        t_closest, b, s_near, s_length: [n], see `environment_segments`.
        offsets: [n + 1] int64, ray i owns the sample slots offsets[i]:offsets[i + 1], one a step.
        jitter: [n] in [0, 1), place of the sample within each step.
        infinite: [n] bool, the ray is closed by the outermost shell.
        log_radius: logarithm of the outermost shell's radius.
        gradient_near: t below which gradients are scaled by (t / gradient_near)^2; 0 for none.
        transmittance_limit: stop below; depth_limit: optical depths below are skipped.
        keep: write the sample records for the backward pass.
        radiance [n, 3], transmittance [n], live [n] int64 samples kept, cells [m, 3] int32 (k, row + 1, column),
        fractions [m, 3], local [m, 7]: d optical depth / d raw, opacity, transmittance before, color, scale of the
        gradient: outputs.
    """
    shells, rows, columns = raw.shape[0], raw.shape[1], raw.shape[2]
    to_shell = (shells - 1) / log_radius
    for i in prange(origins.shape[0]):
        ox, oy, oz = float(origins[i, 0]), float(origins[i, 1]), float(origins[i, 2])
        dx, dy, dz = float(directions[i, 0]), float(directions[i, 1]), float(directions[i, 2])
        first = offsets[i]
        steps = offsets[i + 1] - first
        red, green, blue, passed = 0.0, 0.0, 0.0, 1.0
        count = 0
        slots = steps - 1 if infinite[i] else steps
        step = s_length[i] / slots if slots > 0 else 0.0
        e = math.exp(s_near[i] + jitter[i] * step)
        growth = math.exp(step)
        for n in range(steps):
            closing = n == slots
            if closing:
                e = math.exp(s_near[i] + s_length[i])
            inverse = 1.0 / e
            t = t_closest[i] + 0.5 * b[i] * (e - inverse)
            radius = 0.5 * b[i] * (e + inverse)
            e *= growth
            k_real = min(max(math.log(radius) * to_shell, 0.0), shells - 1.0)
            k = min(int(k_real), shells - 2)
            j, c, fj, fc = angular_cell(ox + t * dx, oy + t * dy, oz + t * dz, rows, columns)
            fk = k_real - k
            top, bottom, tl, tr, bl, br = cell_columns(j, c, rows, columns)
            w0 = (1.0 - fj) * (1.0 - fc)
            w1 = (1.0 - fj) * fc
            w2 = fj * (1.0 - fc)
            w3 = fj * fc
            g0 = 1.0 - fk
            slope = 0.0
            alpha = 1.0
            if not closing:
                value = g0 * (
                    w0 * raw[k, top, tl, 0]
                    + w1 * raw[k, top, tr, 0]
                    + w2 * raw[k, bottom, bl, 0]
                    + w3 * raw[k, bottom, br, 0]
                ) + fk * (
                    w0 * raw[k + 1, top, tl, 0]
                    + w1 * raw[k + 1, top, tr, 0]
                    + w2 * raw[k + 1, bottom, bl, 0]
                    + w3 * raw[k + 1, bottom, br, 0]
                )
                q = math.exp(-abs(value))
                density = density_gain * (max(value, 0.0) + math.log1p(q))
                depth = density * step
                if depth < depth_limit:
                    continue
                slope = density_gain * step * (1.0 / (1.0 + q) if value >= 0.0 else q / (1.0 + q))
                alpha = -math.expm1(-depth)
            weight = passed * alpha
            m = first + count
            for channel in range(3):
                value = g0 * (
                    w0 * raw[k, top, tl, channel + 1]
                    + w1 * raw[k, top, tr, channel + 1]
                    + w2 * raw[k, bottom, bl, channel + 1]
                    + w3 * raw[k, bottom, br, channel + 1]
                ) + fk * (
                    w0 * raw[k + 1, top, tl, channel + 1]
                    + w1 * raw[k + 1, top, tr, channel + 1]
                    + w2 * raw[k + 1, bottom, bl, channel + 1]
                    + w3 * raw[k + 1, bottom, br, channel + 1]
                )
                color = math.exp(min(max(value, -COLOR_LIMIT), COLOR_LIMIT))
                if channel == 0:
                    red += weight * color
                elif channel == 1:
                    green += weight * color
                else:
                    blue += weight * color
                if keep:
                    local[m, 3 + channel] = color
            if keep:
                cells[m, 0] = k
                cells[m, 1] = j
                cells[m, 2] = c
                fractions[m, 0] = fk
                fractions[m, 1] = fj
                fractions[m, 2] = fc
                local[m, 0] = slope
                local[m, 1] = alpha
                local[m, 2] = passed
                local[m, 6] = min(1.0, (t / gradient_near) ** 2) if gradient_near > 0.0 else 1.0
                count += 1
            passed *= 1.0 - alpha
            if passed <= transmittance_limit:
                break
        radiance[i, 0] = red
        radiance[i, 1] = green
        radiance[i, 2] = blue
        transmittance[i] = passed
        live[i] = count


@njit(cache=True, parallel=True, fastmath=True, error_model="numpy")
def sample_gradients(offsets, live, local, radiance, transmittance, g_radiance, g_transmittance, g_samples, used):
    """Gradients of the raw values at every kept sample, [m, 4]; `used` [m] marks slots that hold one."""
    for i in prange(live.shape[0]):
        first = offsets[i]
        behind_r, behind_g, behind_b = float(radiance[i, 0]), float(radiance[i, 1]), float(radiance[i, 2])
        gr, gg, gb = float(g_radiance[i, 0]), float(g_radiance[i, 1]), float(g_radiance[i, 2])
        g_t = float(g_transmittance[i]) * float(transmittance[i])
        if gr == 0.0 and gg == 0.0 and gb == 0.0 and g_t == 0.0:
            continue
        for m in range(first, first + live[i]):
            alpha, passed, scale = float(local[m, 1]), float(local[m, 2]), float(local[m, 6])
            red, green, blue = float(local[m, 3]), float(local[m, 4]), float(local[m, 5])
            weight = passed * alpha
            behind_r -= weight * red
            behind_g -= weight * green
            behind_b -= weight * blue
            rest = passed * (1.0 - alpha)
            g_depth = gr * (rest * red - behind_r) + gg * (rest * green - behind_g) - g_t
            g_depth += gb * (rest * blue - behind_b)
            g_samples[m, 0] = scale * g_depth * local[m, 0]
            g_samples[m, 1] = scale * gr * weight * red
            g_samples[m, 2] = scale * gg * weight * green
            g_samples[m, 3] = scale * gb * weight * blue
            used[m] = 1


@njit(cache=True)
def order_by_row(used, cells, rows):
    """Counting sort of the used samples by grid row: (order, start [rows + 2])."""
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


@njit(cache=True, parallel=True, fastmath=True, error_model="numpy")
def scatter_rows(order, start, cells, fractions, g_samples, g_raw, parity):
    """Add sample gradients to the grid for the row cells of one parity: these touch disjoint rows."""
    rows, columns = g_raw.shape[1], g_raw.shape[2]
    for half_j in prange((rows + 2 - parity) // 2):
        j = 2 * half_j + parity
        for p in range(start[j], start[j + 1]):
            m = order[p]
            k, c = cells[m, 0], cells[m, 2]
            fk, fj, fc = fractions[m, 0], fractions[m, 1], fractions[m, 2]
            top, bottom, tl, tr, bl, br = cell_columns(j, c, rows, columns)
            for side in range(2):
                g = fk if side else 1 - fk
                w0 = g * (1 - fj) * (1 - fc)
                w1 = g * (1 - fj) * fc
                w2 = g * fj * (1 - fc)
                w3 = g * fj * fc
                for channel in range(4):
                    value = g_samples[m, channel]
                    g_raw[k + side, top, tl, channel] += w0 * value
                    g_raw[k + side, top, tr, channel] += w1 * value
                    g_raw[k + side, bottom, bl, channel] += w2 * value
                    g_raw[k + side, bottom, br, channel] += w3 * value
