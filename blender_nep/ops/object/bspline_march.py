"""Marches rays through a quadratic B-spline volume, to the places where it is near zero."""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np
import torch
from numba import prange

from blender_nep.ops.compilation import kernel
from blender_nep.ops.object.bspline import axis_taps, sample_torch
from blender_nep.ops.object.bspline_bricks import Bricks, brick_value, sample_bricks_torch
from blender_nep.ops.precision import at_least_float32

_NO_SLOTS, _NO_COEFFICIENTS = np.empty((0, 0, 0), np.int32), np.empty((0, 1, 1, 1), np.float32)


@kernel(inline="always")
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


@kernel(parallel=True, fastmath=True)
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

    origins, directions [n, 3]; t_near, t_far [n]; `step` is the smallest step (about half a cell); in the torch body, it is
    the only one. Returns spans [n, most, 2] (start and end as distances along the ray) and count [n], their number. If
    a ray has no span before it falls below -band, it gets one there. There is no gradient. Works on the CPU and on any other
    torch device.
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
    """The body of `march` in plain torch, for any device and any float type.

    It looks at all steps of a ray at once, because a graphics card would wait for each of many small steps. So it takes
    samples at multiples of `step`, where the Numba body goes on from where it is, and the ends of a span differ by a step.
    """
    rays = [part.split(_RAYS) for part in (origins, directions, t_near, t_far)]
    parts = [_march_some(coef, fine, band, step, most, *some) for some in zip(*rays, strict=True)]
    return torch.cat([spans for spans, _ in parts]), torch.cat([count for _, count in parts])


_RAYS = 1 << 13
"""Rays that `march_torch` handles at a time. Its memory is proportional to this."""
_BLOCK = 8
"""Steps that `march_torch` leaves out together, where the value at their middle says that the band is far."""


def _march_some(coef, fine, band, step, most, origins, directions, t_near, t_far):
    """What `march` returns, for some of its rays."""
    n, device = len(origins), origins.device
    longest = float((t_far - t_near).nan_to_num(0).amax()) if n else 0.0
    blocks = max(1, math.ceil(longest / (step * _BLOCK)))

    def value(ray, t):
        points = (origins[ray] + t[:, None] * directions[ray]).clamp(-1, 1)
        v = sample_torch(coef, points)[:, 0]
        if fine is None:
            return v
        return v + sample_bricks_torch(fine._replace(coefficients=fine.coefficients.detach()), points)[:, 0]

    begin = t_near[:, None] + torch.arange(blocks, device=device) * (step * _BLOCK)
    ray, block = (begin < t_far[:, None]).nonzero().unbind(1)
    # Outside the band, the SDF limits the step. The factor is 0.7, because a learned SDF is not exact.
    half = 0.5 * (t_far[ray] - begin[ray, block]).clamp(max=step * _BLOCK)
    looked = 0.7 * (value(ray, begin[ray, block] + half) - band) < half
    ray, block = ray[looked], block[looked]
    t = begin[ray, block, None] + torch.arange(_BLOCK, device=device) * step
    v = value(ray.repeat_interleave(_BLOCK), t.reshape(-1)).reshape(t.shape)
    v = torch.where(t < t_far[ray, None], v, torch.inf)
    near, deep = (torch.zeros(n, blocks, _BLOCK, dtype=torch.bool, device=device) for _ in range(2))
    near[ray, block], deep[ray, block] = v.abs() < band, v <= -band
    return _spans(near.flatten(1), deep.flatten(1), t_near, t_far, step, most)


def _spans(near, deep, t_near, t_far, step, most):
    """Spans [n, most, 2] and count [n] from the steps [n, m] that are in the band, and those that are below it."""
    before = deep.cumsum(1) == 0  # behind the first place below the band nothing counts
    near = near & before
    padded = torch.nn.functional.pad(near, (1, 1))
    enters, leaves = padded[:, 1:] & ~padded[:, :-1], padded[:, :-1] & ~padded[:, 1:]
    spans = torch.zeros(len(near), most, 2, dtype=t_near.dtype, device=near.device)
    number = enters.cumsum(1)
    for end, (edge, back) in enumerate(((enters, 1), (leaves, 0))):
        ray, place = edge.nonzero().unbind(1)
        rank = number[ray, place] - 1
        some = rank < most
        ray, place, rank = ray[some], place[some], rank[some]
        t = t_near[ray] + (place - back) * step
        spans[ray, rank, end] = torch.minimum(torch.maximum(t, t_near[ray]), t_far[ray])
    count = number[:, -1].clamp(max=most).int()
    jumped = ((count == 0) & ~before[:, -1]).nonzero()[:, 0]
    t = t_near[jumped] + before[jumped].sum(1) * step
    spans[jumped, 0] = torch.stack([torch.maximum(t - step, t_near[jumped]), t], -1)
    count[jumped] = 1
    return spans, count
