"""Robust fits of albedos to photo samples on the CPU, with a fused Numba kernel.

A task is one roughness for one group of samples. The radiance is affine in the albedo: its terms are interpolated once, and
stay in the cache while the albedo is iterated. Sums are in float64. One thread does a whole task, so that results do not
depend on the number of threads.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import prange

from blender_nep.ops.compilation import kernel
from blender_nep.ops.tone import tone


@kernel(inline="always", fastmath=True, error_model="numpy")
def _multiscatter_gain(albedo, ratio, average):
    """Factor of a metal's radiance that adds the light that is scattered more than once.

    It is `brdf.multiscatter_scale` of `brdf.metal_fss` for one albedo. ratio is (1 - E) / E; average is E_avg.
    """
    fss = albedo + (np.float32(1) - albedo) / np.float32(21)
    return np.float32(1) + fss * average / (np.float32(1) - fss * (np.float32(1) - average)) * ratio


class FitSamples(NamedTuple):
    """n photo samples in the order of their groups, for R roughness values; all float32."""

    specular: np.ndarray
    """[n, L, 3, 3] moments (full, edge, dielectric) of the light at L roughness levels, with three colors each"""
    diffuse: np.ndarray
    """[n, 3] irradiance divided by pi"""
    goal: np.ndarray
    """[n, 3] linear radiance that the photo shows"""
    tone_goal: np.ndarray
    """[n, 3] tone-mapped radiance that the photo shows"""
    weight: np.ndarray
    """[n] how much a sample counts"""
    ratio: np.ndarray
    """[n, R] (1 - E) / E of the specular lobe, see `brdf.specular_albedo`"""
    specular_scale: np.ndarray
    """[n, R] factor of the dielectric's specular lobe"""
    diffuse_scale: np.ndarray
    """[n, R] factor of the dielectric's diffuse lobe"""


class FitRoughness(NamedTuple):
    """The R roughness values, and their places between the roughness levels of the light."""

    low: np.ndarray
    """[R] int64, index of the level below"""
    mix: np.ndarray
    """[R] float32 in 0..1, place between that level and the next"""
    average: np.ndarray
    """[R] float32, E_avg, see `brdf.average_specular_albedo`"""


class FitHypotheses(NamedTuple):
    """M values of `metallic`."""

    metallic: np.ndarray
    """[M] float32 in 0..1"""
    limit: np.ndarray
    """[M] float32, the largest albedo"""


@kernel(inline="always", fastmath=True, error_model="numpy")
def _affine_terms(samples, roughness, first, count, j):
    """The radiance of `count` samples from `first` on, at the j-th roughness, as terms of functions of the albedo.

    A metal has the radiance gain * (edge + span * albedo), a dielectric specular_part + diffuse_part * albedo. Returns edge,
    span, specular_part, diffuse_part [count, 3], and the sum of the samples' weights.
    """
    specular, diffuse = samples.specular, samples.diffuse
    edge, span = np.empty((count, 3), np.float32), np.empty((count, 3), np.float32)
    specular_part, diffuse_part = np.empty((count, 3), np.float32), np.empty((count, 3), np.float32)
    level, share = roughness.low[j], roughness.mix[j]
    total = 0.0
    for s in range(count):
        n = first + s
        total += samples.weight[n]
        for c in range(3):
            full = specular[n, level, 0, c] + share * (specular[n, level + 1, 0, c] - specular[n, level, 0, c])
            edge[s, c] = specular[n, level, 1, c] + share * (specular[n, level + 1, 1, c] - specular[n, level, 1, c])
            span[s, c] = full - edge[s, c]
            coat = specular[n, level, 2, c] + share * (specular[n, level + 1, 2, c] - specular[n, level, 2, c])
            specular_part[s, c] = samples.specular_scale[n, j] * coat
            diffuse_part[s, c] = samples.diffuse_scale[n, j] * diffuse[n, c]
    return edge, span, specular_part, diffuse_part, total


@kernel(parallel=True, fastmath=True, error_model="numpy")
def fit_albedos(starts, samples, roughness, hypotheses, clip, iterations, cost, albedo):
    """Fill cost [M, R, G] and albedo [M, R, G, 3] for M values of metallic, R roughness values and G groups.

    Group g has the `FitSamples` starts[g] to starts[g + 1] - 1, starts [G + 1]. The least squares are reweighted in each of
    `iterations`. `clip` is the largest residual that a sample may count with.
    """
    metallic, limit = hypotheses
    weight, goal, tone_goal, ratio, average = (
        samples.weight,
        samples.goal,
        samples.tone_goal,
        samples.ratio,
        roughness.average,
    )
    groups, steps = cost.shape[2], cost.shape[1]
    for task in prange(groups * steps):
        g, j = task // steps, task % steps
        first = starts[g]
        count = starts[g + 1] - first
        edge, span, specular_part, diffuse_part, total = _affine_terms(samples, roughness, first, count, j)
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
                            residual = abs(tone(light) - tone_goal[n, c])
                            if residual >= 2 * clip:
                                continue
                            robust /= max(residual, np.float32(0.02))
                        # d tone / d radiance turns a linear residual into a tone-mapped one; 1 / |residual| makes it L1
                        robust /= (np.float32(1) + np.float32(4) * mean) ** 2
                        # A metal's reflections are never quite in place. Least squares would take the misplaced light for
                        # noise of the slope, and make the metal too dark. `mean` treats prediction and photo alike.
                        instrument = metal * mean + rest * slope
                        top += robust * instrument * (goal[n, c] - offset)
                        bottom += robust * instrument * slope
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
                    residual += abs(tone(light) - tone_goal[n, c])
                left += min(residual / np.float32(3), clip) * weight[n]
            cost[i, j, g] = left / max(total, 1e-9)
            for c in range(3):
                albedo[i, j, g, c] = a[c]
