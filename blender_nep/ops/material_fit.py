"""Robust fits of albedos to photo samples on the CPU: a fused Numba kernel.

A task is one roughness of one group of samples. Its radiance is affine in the albedo: the terms are interpolated once and
stay in the cache while the albedo is iterated. Sums are in float64; each task is one thread's, so that results do not depend
on the number of threads.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit, prange

_LOG5 = np.float32(math.log(5.0))


@njit(cache=True, inline="always", fastmath=True, error_model="numpy")
def _multiscatter_gain(albedo, ratio, average):
    """Factor of a metal's radiance that adds the light scattered more than once, at one albedo: `brdf.multiscatter_scale` of
    `brdf.metal_fss`. ratio: (1 - E) / E; average: E_avg."""
    fss = albedo + (np.float32(1) - albedo) / np.float32(21)
    return np.float32(1) + fss * average / (np.float32(1) - fss * (np.float32(1) - average)) * ratio


@njit(cache=True, inline="always", fastmath=True, error_model="numpy")
def _tone(light):
    """`tone_mapping.tone_map` by log, three times as fast as log1p; its error near black, 1e-7, is nothing to a photo."""
    return math.log(np.float32(1) + np.float32(4) * light) / _LOG5


class FitSamples(NamedTuple):
    """n photo samples in the order of their groups, for R roughnesses; all float32."""

    specular: np.ndarray
    """[n, L, 3, 3] moments (full, edge, dielectric) of the light at L roughness levels, a color each"""
    diffuse: np.ndarray
    """[n, 3] irradiance over pi"""
    goal: np.ndarray
    """[n, 3] linear radiance that the photo shows"""
    tone_goal: np.ndarray
    """[n, 3] the same, tone-mapped"""
    weight: np.ndarray
    """[n]"""
    ratio: np.ndarray
    """[n, R] (1 - E) / E of the lobe, see `brdf.specular_albedo`"""
    specular_scale: np.ndarray
    """[n, R] of the dielectric's specular lobe"""
    diffuse_scale: np.ndarray
    """[n, R] of the dielectric's diffuse lobe"""


class FitRoughness(NamedTuple):
    """The R roughnesses, between the roughness levels of the light."""

    low: np.ndarray
    """[R] int64, the level below"""
    mix: np.ndarray
    """[R] float32 in 0..1, how far it is to the next level"""
    average: np.ndarray
    """[R] float32, see `brdf.average_specular_albedo`"""


class FitHypotheses(NamedTuple):
    """M values of `metallic`."""

    metallic: np.ndarray
    """[M] float32 in 0..1"""
    limit: np.ndarray
    """[M] float32, the largest albedo"""


@njit(cache=True, inline="always", fastmath=True, error_model="numpy")
def _affine_terms(samples, roughness, first, count, j):
    """The radiance of `count` samples from `first` on at the j-th roughness, as terms of two functions of the albedo:
    gain * (edge + span * albedo) of a metal, specular_part + diffuse_part * albedo of a dielectric.

    Returns edge, span, specular_part, diffuse_part [count, 3], and the sum of the samples' weights.
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


@njit(cache=True, parallel=True, fastmath=True, error_model="numpy")
def fit_albedos(starts, samples, roughness, hypotheses, clip, iterations, cost, albedo):
    """Fills cost [M, R, G] and albedo [M, R, G, 3] of M hypotheses, R roughnesses and G groups.

    The g-th group are the `FitSamples` from starts[g] to starts[g + 1] [G + 1]. Least squares are reweighted `iterations`
    times; clip: the largest residual of a sample.
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
