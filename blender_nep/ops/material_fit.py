"""Robust fits of albedos to photo samples on the CPU: a fused Numba kernel.

A task is one roughness of one group of samples: its lines are interpolated once and stay in the cache while the albedo is
iterated. Sums are in float64; each task is one thread's: results do not depend on their number.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit, prange

_LOG5 = np.float32(math.log(5.0))


@njit(cache=True, inline="always", fastmath=True, error_model="numpy")
def _multiscatter_gain(albedo, ratio, average):
    """Of a metal, by light that is scattered more than once: `brdf.multiscatter_scale` of `brdf.metal_fss`."""
    fss = albedo + (np.float32(1) - albedo) / np.float32(21)
    return np.float32(1) + fss * average / (np.float32(1) - fss * (np.float32(1) - average)) * ratio


@njit(cache=True, inline="always", fastmath=True, error_model="numpy")
def _tone(light):
    """`metrics.tone_map`; log is three times as fast as log1p, and its error of 1e-7 near black is nothing to a photo."""
    return math.log(np.float32(1) + np.float32(4) * light) / _LOG5


@njit(cache=True, parallel=True, fastmath=True, error_model="numpy")
def fit_lines(
    starts,
    specular,
    diffuse,
    goal,
    tone_goal,
    weight,
    ratio,
    specular_scale,
    diffuse_scale,
    low,
    mix,
    average,
    metallic,
    limit,
    clip,
    iterations,
    cost,
    albedo,
):
    """Fills cost [M,R,G] and albedo [M,R,G,3] for M values of `metallic`, R roughnesses, G groups.

    Samples n in the order of their groups, which begin at starts [G+1]: specular [n,L,3,3] the moments (full, edge,
    dielectric) at L roughness levels, diffuse, goal, tone_goal [n,3], weight [n]; ratio [n,R]: (1 - E) / E of the lobe;
    specular_scale, diffuse_scale [n,R]: of the dielectric's lobes. low, mix [R]: the level below a roughness and how
    far it is to the next; average [R]: mean of E. limit [M]: of the albedo. All float32 but starts and low.
    """
    groups, steps = cost.shape[2], cost.shape[1]
    for task in prange(groups * steps):
        g, j = task // steps, task % steps
        first = starts[g]
        count = starts[g + 1] - first
        # radiance: gain * (edge + span * albedo) of a metal, specular_part + diffuse_part * albedo of a dielectric
        edge, span = np.empty((count, 3), np.float32), np.empty((count, 3), np.float32)
        specular_part, diffuse_part = np.empty((count, 3), np.float32), np.empty((count, 3), np.float32)
        level, share = low[j], mix[j]
        total = 0.0
        for s in range(count):
            n = first + s
            total += weight[n]
            for c in range(3):
                full = specular[n, level, 0, c] + share * (specular[n, level + 1, 0, c] - specular[n, level, 0, c])
                edge[s, c] = specular[n, level, 1, c] + share * (specular[n, level + 1, 1, c] - specular[n, level, 1, c])
                span[s, c] = full - edge[s, c]
                coat = specular[n, level, 2, c] + share * (specular[n, level + 1, 2, c] - specular[n, level, 2, c])
                specular_part[s, c] = specular_scale[n, j] * coat
                diffuse_part[s, c] = diffuse_scale[n, j] * diffuse[n, c]
        for i in range(len(metallic)):
            metal, rest = metallic[i], np.float32(1) - metallic[i]
            a = np.full(3, np.float32(0.5))
            for k in range(iterations):
                for c in range(3):
                    top = bottom = 0.0
                    for s in range(count):
                        n = first + s
                        gain = metal * _multiscatter_gain(a[c], ratio[n, j], average[j])
                        offset = gain * edge[s, c] + rest * specular_part[s, c]
                        slope = gain * span[s, c] + rest * diffuse_part[s, c]
                        light = max(offset + slope * a[c], np.float32(0))
                        robust = weight[n]
                        if k == 0:
                            mean = goal[n, c]
                        else:
                            mean = np.float32(0.5) * (light + goal[n, c])
                            residual = abs(_tone(light) - tone_goal[n, c])
                            if residual >= 2 * clip:
                                continue
                            robust /= max(residual, np.float32(0.02))
                        # d tone / d radiance turns the tone-mapped residual into a linear one; 1 / |residual| makes it L1
                        robust /= (np.float32(1) + np.float32(4) * mean) ** 2
                        top += robust * slope * (goal[n, c] - offset)
                        bottom += robust * slope * slope
                    a[c] = min(max(top / max(bottom, 1e-12), 0.0), limit[i])
            left = 0.0
            for s in range(count):
                n = first + s
                residual = np.float32(0)
                for c in range(3):
                    gain = metal * _multiscatter_gain(a[c], ratio[n, j], average[j])
                    light = max(
                        gain * (edge[s, c] + span[s, c] * a[c]) + rest * (specular_part[s, c] + diffuse_part[s, c] * a[c]),
                        np.float32(0),
                    )
                    residual += abs(_tone(light) - tone_goal[n, c])
                left += min(residual / np.float32(3), clip) * weight[n]
            cost[i, j, g] = left / max(total, 1e-9)
            for c in range(3):
                albedo[i, j, g, c] = a[c]
