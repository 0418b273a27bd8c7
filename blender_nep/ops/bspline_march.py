"""Marches rays through a quadratic B-spline volume, to the places where it is near zero."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
import torch
from numba import njit, prange

from blender_nep.ops.bspline import axis_taps, sample_torch
from blender_nep.ops.bspline_bricks import Bricks, brick_value, sample_bricks_torch
from blender_nep.ops.precision import at_least_float32

_NO_SLOTS, _NO_COEFFICIENTS = np.empty((0, 0, 0), np.int32), np.empty((0, 1, 1, 1), np.float32)


@njit(cache=True, inline="always")
def _value(coef, x, y, z, w, d, e):
    cells = coef.shape[0] - 2
    i = axis_taps(x, cells, w[0], d[0], e[0])
    j = axis_taps(y, cells, w[1], d[1], e[1])
    m = axis_taps(z, cells, w[2], d[2], e[2])
    v = coef[0, 0, 0] * 0
    for a in range(3):
        for c in range(3):
            row = coef[i + a, j + c]
            v += w[0, a] * w[1, c] * (row[m] * w[2, 0] + row[m + 1] * w[2, 1] + row[m + 2] * w[2, 2])
    return v


class _Fine(NamedTuple):
    """`Bricks` as arrays. `slot` is empty if there are none."""

    slot: np.ndarray
    coefficients: np.ndarray
    cells: int


class _Rays(NamedTuple):
    """n rays: origins, directions [n, 3], and the distances t_near, t_far [n] at which they enter and leave the volume."""

    origins: np.ndarray
    directions: np.ndarray
    t_near: np.ndarray
    t_far: np.ndarray


@njit(cache=True, parallel=True, fastmath=True)
def _march(coef, fine, rays, band, step, spans, count, threads):
    """Fill spans [n, most, 2] and count [n]; see `march`. The threads share the rays in blocks."""
    origins, directions, t_near, t_far = rays
    n, most = origins.shape[0], spans.shape[1]
    has_fine = fine.slot.shape[0] > 0
    blocks = threads * 8
    for b in prange(blocks):
        w = np.empty((3, 3), coef.dtype)
        d = np.empty((3, 3), coef.dtype)
        e = np.empty((3, 3), coef.dtype)
        for k in range(b * n // blocks, (b + 1) * n // blocks):
            t, spans_here, inside, start = t_near[k], 0, False, t_near[k]
            while t < t_far[k]:
                x = origins[k, 0] + t * directions[k, 0]
                y = origins[k, 1] + t * directions[k, 1]
                z = origins[k, 2] + t * directions[k, 2]
                v = _value(coef, x, y, z, w, d, e)
                if has_fine:
                    v += brick_value(fine.slot, fine.coefficients, fine.cells, x, y, z, w, d, e)
                near = v < band and v > -band
                if near and not inside:
                    start = max(t - step, t_near[k])
                    inside = True
                elif inside and not near:
                    spans[k, spans_here, 0] = start
                    spans[k, spans_here, 1] = t
                    spans_here += 1
                    inside = False
                if v <= -band:
                    if spans_here == 0:  # the ray starts inside the surface, or a step jumped over the band
                        spans[k, 0, 0] = max(t - step, t_near[k])
                        spans[k, 0, 1] = t
                        spans_here = 1
                    break
                if spans_here == most:
                    break
                # Outside the band, the SDF limits the step. The factor is 0.7, because a learned SDF is not exact.
                t += step if near else max(step, 0.7 * (v - band))
            if inside and spans_here < most:
                spans[k, spans_here, 0] = start
                spans[k, spans_here, 1] = min(t, t_far[k])
                spans_here += 1
            count[k] = spans_here


def march(coef, origins, directions, t_near, t_far, band: float, step: float, most: int = 4, fine: Bricks | None = None):
    """Find the spans of each ray in which |spline| < band, up to the first place where the spline falls below -band.

    origins, directions [n, 3]; t_near, t_far [n]; `step` is the smallest step (about half a cell). Returns spans [n, most,
    2] (start and end as distances along the ray) and count [n], the number of spans. If a ray has no span before it falls
    below -band, it gets one there. There is no gradient. Works on the CPU and on any other torch device.
    """
    coef, origins, directions, t_near, t_far = at_least_float32(coef.detach(), origins, directions, t_near, t_far)
    if coef.device.type == "cpu":
        spans = np.zeros((origins.shape[0], most, 2), np.float32)
        count = np.zeros(origins.shape[0], np.int32)
        bricks = _Fine(_NO_SLOTS, _NO_COEFFICIENTS, 1)
        if fine is not None:
            bricks = _Fine(fine.slot.numpy(), at_least_float32(fine.coefficients.detach())[0].numpy(), fine.cells)
        _march(
            coef.numpy(),
            bricks,
            _Rays(*(part.numpy() for part in (origins, directions, t_near, t_far))),
            np.float32(band),
            np.float32(step),
            spans,
            count,
            numba.get_num_threads(),
        )
        return torch.from_numpy(spans), torch.from_numpy(count)
    return march_torch(coef, origins, directions, t_near, t_far, band, step, most, fine)


def march_torch(
    coef, origins, directions, t_near, t_far, band: float, step: float, most: int = 4, fine: Bricks | None = None
):
    """The body of `march` in plain torch, for any device and any float type."""
    n, device = origins.shape[0], origins.device
    spans = torch.zeros(n, most, 2, device=device)
    count = torch.zeros(n, dtype=torch.int32, device=device)
    t, start = t_near.clone(), t_near.clone()
    inside = torch.zeros(n, dtype=torch.bool, device=device)
    alive = t < t_far
    while bool(alive.any()):
        k = alive.nonzero()[:, 0]
        tk = t[k]
        point = (origins[k] + tk[:, None] * directions[k]).clamp(-1, 1)
        v = sample_torch(coef, point)[:, 0]
        if fine is not None:
            v = v + sample_bricks_torch(fine._replace(coefficients=fine.coefficients.detach()), point)[:, 0]
        near = v.abs() < band
        enter, leave = near & ~inside[k], inside[k] & ~near
        back = torch.maximum(tk - step, t_near[k])
        start[k] = torch.where(enter, back, start[k])
        jumped = (v <= -band) & (count[k] == 0) & ~leave
        begin = torch.where(jumped, back, start[k])
        close = leave | jumped
        kc = k[close]
        spans[kc, count[kc].long()] = torch.stack([begin[close], tk[close]], -1)
        count[kc] += 1
        inside[k] = near
        alive[k] = (v > -band) & (count[k] < most)
        t[k] = tk + torch.where(near, torch.full_like(v, step), (0.7 * (v - band)).clamp(min=step))
        alive &= t < t_far
    k = (inside & (count < most)).nonzero()[:, 0]
    spans[k, count[k].long()] = torch.stack([start[k], torch.minimum(t[k], t_far[k])], -1)
    count[k] += 1
    return spans, count
