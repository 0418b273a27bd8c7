"""Cones through the prefiltered environment: one march along the axis, at the level as wide as the cone is there.

A level holds, for every shell, means over discs of one angular radius: premultiplied radiance, opacity of one shell
spacing, and opacity times coverage. Crassin et al. 2011, voxel cone tracing, in spherical coordinates.
"""

from __future__ import annotations

import math

import numba
import numpy as np
import torch
from numba import njit, prange

from blender_nep.ops.environment_rendering_numba import angular_cell, cell_columns


@njit(cache=True, inline="always")
def _add_level(grid, k, fk, x, y, z, share, out):
    """Adds share * (bilinear value at a direction, linear between shells k and k + 1) to out [5]."""
    rows, columns = grid.shape[1], grid.shape[2]
    j, c, fj, fc = angular_cell(x, y, z, rows, columns)
    top, bottom, tl, tr, bl, br = cell_columns(j, c, rows, columns)
    for a in range(2):
        s = share * (fk if a else 1.0 - fk)
        for h in range(5):
            out[h] += s * ((1 - fj) * ((1 - fc) * grid[k + a, top, tl, h] + fc * grid[k + a, top, tr, h])
                           + fj * ((1 - fc) * grid[k + a, bottom, bl, h] + fc * grid[k + a, bottom, br, h]))


@njit(cache=True, parallel=True)
def _march(levels_of, radii, origins, directions, near, half_angle, log_outer, shells, step, out, threads):
    n, blocks = origins.shape[0], threads * 16
    levels = radii.shape[0]
    spacing = log_outer / (shells - 1)
    for b in prange(blocks):
        value = np.empty(5)
        for i in range(b * n // blocks, (b + 1) * n // blocks):
            passed, t = 1.0, near[i]
            # wide cones are blurred along the ray as well: longer steps
            stride = step * min(3.0, 1.0 + 4.0 * half_angle[i])
            for h in range(4):
                out[i, h] = 0.0
            while passed > 0.005:
                x = origins[i, 0] + t * directions[i, 0]
                y = origins[i, 1] + t * directions[i, 1]
                z = origins[i, 2] + t * directions[i, 2]
                radius = max(math.sqrt(x * x + y * y + z * z), 1.0)
                place = math.log(radius) / log_outer * (shells - 1)
                closing = place >= shells - 1
                place = min(place, shells - 1.0)
                k = min(int(place), shells - 2)
                angle = half_angle[i] * t / radius
                level = 0
                while level < levels - 2 and radii[level + 1] < angle:
                    level += 1
                mix = (math.log(max(angle, 1e-6) / radii[level]) / math.log(radii[level + 1] / radii[level]))
                mix = min(max(mix, 0.0), 1.0)
                for h in range(5):
                    value[h] = 0.0
                for g in range(2):
                    share = mix if g else 1.0 - mix
                    if share > 0.0:
                        _add_level(levels_of[level + g], k, place - k, x, y, z, share, value)
                opacity = min(max(value[3], 0.0), 1.0)
                if opacity > 1e-6:
                    alpha = 1.0 if closing else 1.0 - (1.0 - min(opacity, 0.999999)) ** (stride / spacing)
                    weight = passed * alpha / opacity
                    out[i, 0] += weight * value[0]
                    out[i, 1] += weight * value[1]
                    out[i, 2] += weight * value[2]
                    out[i, 3] += weight * value[4]
                    passed *= 1.0 - alpha
                if closing:
                    break
                t += stride * radius
            seen = 1.0 - passed
            if seen > 0.0:
                for h in range(4):
                    out[i, h] /= seen


@njit(cache=True)
def accumulate_evidence(raw, origins, directions, near, log_outer, density_gain, step, evidence):
    """Adds to evidence [K, H, W] the weight with which each camera ray sees each node (nearest). One thread: no race."""
    shells, rows, columns = raw.shape[0], raw.shape[1], raw.shape[2]
    for i in range(origins.shape[0]):
        passed, t = 1.0, near[i]
        while passed > 0.01:
            x = origins[i, 0] + t * directions[i, 0]
            y = origins[i, 1] + t * directions[i, 1]
            z = origins[i, 2] + t * directions[i, 2]
            radius = max(math.sqrt(x * x + y * y + z * z), 1.0)
            place = math.log(radius) / log_outer * (shells - 1)
            closing = place >= shells - 1
            k = min(int(place + 0.5), shells - 1)
            j, c, fj, fc = angular_cell(x, y, z, rows, columns)
            row = min(max(j - 1 if fj < 0.5 else j, 0), rows - 1)
            column = c if fc < 0.5 else (c + 1) % columns
            value = raw[k, row, column, 0]
            density = density_gain * (max(value, 0.0) + math.log1p(math.exp(-abs(value))))
            alpha = 1.0 if closing else 1.0 - math.exp(-density * step)
            evidence[k, row, column] += passed * alpha
            passed *= 1.0 - alpha
            if closing:
                break
            t += step * radius


def level_list(levels: list[torch.Tensor]) -> numba.typed.List:
    """Levels [K, H_l, W_l, 5] as the kernel takes them."""
    return numba.typed.List([level.contiguous().numpy() for level in levels])


def march_cones(levels: numba.typed.List, radii: list[float], origins: torch.Tensor,
                directions: torch.Tensor, near: torch.Tensor, half_angle: torch.Tensor, outer_radius: float,
                step: float) -> torch.Tensor:
    """Mean radiance and coverage [n, 4] in cones; levels [K, H_l, W_l, 5], radii in radians, near [n], half_angle [n].

    The body is Numba's on every device: fields of a GPU are copied once, when they are prefiltered.
    """
    out = np.empty((len(origins), 4), np.float32)
    _march(levels, np.asarray(radii, np.float64),
           *(a.detach().cpu().contiguous().float().numpy() for a in (origins, directions, near, half_angle)),
           math.log(outer_radius), levels[0].shape[0], step, out, numba.get_num_threads())
    return torch.from_numpy(out).to(origins.device)
