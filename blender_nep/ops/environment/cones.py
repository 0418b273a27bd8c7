"""Composites cones through the prefiltered environment, along their axes. At each shell, the level is as wide as the cone.

A level holds, for every shell, means over discs of one angular radius: premultiplied radiance, opacity of one shell spacing,
and opacity times coverage. This is voxel cone tracing (Crassin et al. 2011) in spherical coordinates.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np
import torch
from numba import prange

from blender_nep.ops.compilation import kernel
from blender_nep.ops.environment.contracted_rays import contraction_border, place_on_ray
from blender_nep.ops.environment.spherical_grid import angular_cell, bilinear_2d, bilinear_weights, cell, cell_columns, polar


@kernel(inline="always", fastmath=True, error_model="numpy")
def _add_level(level, k, turn, fall, share, out):
    """Add share * (bilinear value of shell k) to out [5], in the direction of the `polar` angles turn, fall."""
    nodes, start, rows, columns = level
    j, c, fj, fc = cell(turn, fall, rows, columns)
    top, bottom, tl, tr, bl, br = cell_columns(j, c, rows, columns)
    top, bottom = start + top * columns, start + bottom * columns
    w0 = share * (1.0 - fj) * (1.0 - fc)
    w1 = share * (1.0 - fj) * fc
    w2 = share * fj * (1.0 - fc)
    w3 = share * fj * fc
    for h in range(5):
        out[h] += (
            w0 * nodes[top + tl, k, h]
            + w1 * nodes[top + tr, k, h]
            + w2 * nodes[bottom + bl, k, h]
            + w3 * nodes[bottom + br, k, h]
        )


@kernel(inline="always", fastmath=True, error_model="numpy")
def _sharpen(detail, turn, fall, share, out):
    """Multiply the color of out [5] by the bilinear value of the detail [D, 2 D, 3], mixed with 1 by `share`, 0..1."""
    rows, columns = detail.shape[0], detail.shape[1]
    j, c, fj, fc = cell(turn, fall, rows, columns)
    corners, weights = cell_columns(j, c, rows, columns), bilinear_weights(fj, fc)
    for h in range(3):
        out[h] *= 1.0 + share * (bilinear_2d(detail, corners, weights, h) - 1.0)


class Levels(NamedTuple):
    """The levels of a prefiltered environment in one array: a list of arrays would be compiled anew in each process."""

    nodes: np.ndarray
    """[N, K, 5] of all levels, see `weights.from_weights`"""
    starts: np.ndarray
    """[L] int64: the first node of each level"""
    sizes: np.ndarray
    """[L, 2] int64: rows and columns of each level"""

    @classmethod
    def joined(cls, levels: list[np.ndarray]) -> Levels:
        """The levels, each [H_l, W_l, K, 5]."""
        nodes = [level.reshape(-1, *level.shape[2:]) for level in levels]
        starts = np.cumsum([0, *(len(part) for part in nodes[:-1])])
        return cls(np.concatenate(nodes), starts, np.array([level.shape[:2] for level in levels]))


SKY_RADIUS = 1e9
"""Stands for the infinite radius of the sky. From points in the unit sphere, the sky has no parallax at this distance."""


class _Cones(NamedTuple):
    origins: np.ndarray
    """[n, 3]"""
    directions: np.ndarray
    """[n, 3] unit length"""
    near: np.ndarray
    """[n] shells nearer than this distance are left out"""
    half_angle: np.ndarray
    """[n] radians"""
    order: np.ndarray
    """[n] int64: the order in which the cones are composited"""


_STRIPS = 16
"""Number of strips of the sphere in which cones are sorted."""


def _neighbors_first(directions: torch.Tensor, half_angle: torch.Tensor, ratio: float) -> torch.Tensor:
    """An order [n] of cones. Cones of about the same half angle (within a factor of `ratio`) and of neighboring directions
    follow each other.

    Then most nodes that a cone reads are in the processor's cache. The finest levels are larger than the cache.
    """
    level = (half_angle.clamp(min=1e-6).log() / math.log(ratio)).floor()
    strip = (directions[:, 2].clamp(-1, 1).acos() * (_STRIPS / math.pi)).floor()
    turn = torch.atan2(directions[:, 1], directions[:, 0]) * (0.5 / math.pi)
    return ((level * (_STRIPS + 1) + strip).double() * 2 + turn).argsort()


@kernel(fastmath=True, error_model="numpy")
def _composite_block(block, levels_of, radii, dense_from, detail, shell_radii, occupied, far, cones, out, blocks):
    """What `_composite` does in one of its tasks."""
    nodes, starts, sizes = levels_of
    origins, directions, near, half_angle, order = cones
    n, levels, shells = origins.shape[0], radii.shape[0], shell_radii.shape[0]
    to_level = 1.0 / math.log(radii[1] / radii[0])
    first, to_finer = math.log(radii[0]), 1.0 / math.log(detail.shape[0] / sizes[0, 0])
    value = np.empty(5)
    for p in range(block * n // blocks, (block + 1) * n // blocks):
        i = order[p]
        ox, oy, oz = float(origins[i, 0]), float(origins[i, 1]), float(origins[i, 2])
        dx, dy, dz = float(directions[i, 0]), float(directions[i, 1]), float(directions[i, 2])
        along = ox * dx + oy * dy + oz * dz
        rest = along * along - (ox * ox + oy * oy + oz * oz)
        width = math.log(max(float(half_angle[i]), 1e-6))
        passed, red, green, blue, seen = 1.0, 0.0, 0.0, 0.0, 0.0
        for k in range(shells):
            if not occupied[k]:
                continue
            radius = shell_radii[k]
            t = math.sqrt(max(rest + radius * radius, 0.0)) - along
            if t < near[i] and k < shells - 1:
                continue
            narrower = first - width - math.log(max(t, 1e-6) / radius)
            place = max(-narrower * to_level, 0.0)
            if place > dense_from:  # two levels for each ratio
                place += place - dense_from
            level = min(int(place), levels - 2)
            mix = min(place - level, 1.0)
            turn, fall = polar(ox + t * dx, oy + t * dy, oz + t * dz)
            for h in range(5):
                value[h] = 0.0
            if mix < 1.0:
                _add_level((nodes, starts[level], sizes[level, 0], sizes[level, 1]), k, turn, fall, 1.0 - mix, value)
            if mix > 0.0:
                finer = (nodes, starts[level + 1], sizes[level + 1, 0], sizes[level + 1, 1])
                _add_level(finer, k, turn, fall, mix, value)
            if narrower > 0.0 and far[k] > 0.0:
                _sharpen(detail, turn, fall, far[k] * min(narrower * to_finer, 1.0), value)
            red += passed * value[0]
            green += passed * value[1]
            blue += passed * value[2]
            seen += passed * value[4]
            passed *= 1.0 - min(value[3], 1.0)
            if passed < 1e-3:
                break
        scale = 1.0 / max(1.0 - passed, 1e-9)
        out[i, 0] = red * scale
        out[i, 1] = green * scale
        out[i, 2] = blue * scale
        out[i, 3] = seen * scale


@kernel(parallel=True, fastmath=True, error_model="numpy")
def _composite(levels_of, radii, dense_from, detail, shell_radii, occupied, far, cones, out, blocks):
    """Fill out [n, 4]: mean radiance and coverage of n `_Cones`, in `blocks` parallel tasks. See `composite_cones`.

    The loop is short for the reason that `environment_rendering_numba._march` tells.
    """
    for block in prange(blocks):
        _composite_block(
            np.int64(block), levels_of, radii, dense_from, detail, shell_radii, occupied, far, cones, out, blocks
        )


@kernel()
def accumulate_coverage(raw, rays, medium, seen):
    """Add to seen [K, H, W] the weights with which rays see nodes. Each sample counts for its nearest node.

    raw [K, H, W, 4]; RaySamples and Medium are of NumPy arrays and numbers. The function runs in one thread.
    """
    origins, directions, t_closest, b, w_near, w_length, infinite, offsets, _ = rays
    contraction_radius, density_gain = medium.contraction_radius, medium.density_gain
    shells, rows, columns = raw.shape[0], raw.shape[1], raw.shape[2]
    to_shell = (shells - 1) / (math.log(contraction_radius) + 1.0)
    for i in range(origins.shape[0]):
        samples = offsets[i + 1] - offsets[i]
        steps = samples - 1 if infinite[i] else samples
        step = w_length[i] / steps if steps > 0 else 0.0
        border = contraction_border(b[i], contraction_radius)
        passed = 1.0
        for n in range(samples):
            x, y, z = float(directions[i, 0]), float(directions[i, 1]), float(directions[i, 2])
            place = shells - 1.0
            if n < steps:
                w = w_near[i] + (n + 0.5) * step
                t, place = place_on_ray(w, math.exp(w), b[i], border, contraction_radius, to_shell)
                t += t_closest[i]
                x, y, z = origins[i, 0] + t * x, origins[i, 1] + t * y, origins[i, 2] + t * z
            k = min(max(int(place + 0.5), 0), shells - 1)
            j, c, fj, fc = angular_cell(x, y, z, rows, columns)
            row = min(max(j - 1 if fj < 0.5 else j, 0), rows - 1)
            column = c if fc < 0.5 else (c + 1) % columns
            value = raw[k, row, column, 0]
            density = density_gain * (max(value, 0.0) + math.log1p(math.exp(-abs(value))))
            alpha = 1.0 - math.exp(-density * step) if n < steps else 1.0
            seen[k, row, column] += passed * alpha
            passed *= 1.0 - alpha
            if passed <= 0.01:
                break


def composite_cones(
    levels: Levels,
    radii: list[float],
    dense_from: int,
    detail: np.ndarray,
    shell_radii: torch.Tensor,
    occupied: torch.Tensor,
    far: torch.Tensor,
    origins: torch.Tensor,
    directions: torch.Tensor,
    near: torch.Tensor,
    half_angle: torch.Tensor,
) -> torch.Tensor:
    """Mean radiance and coverage [n, 4] in cones that start inside the innermost shell.

    There is one lookup for each shell, at the level as wide as the cone is there. The Numba body is used on every device:
    the levels of a field on a GPU were copied once, when they were prefiltered.

    Args:
        levels: L of them; radii: angular radii [L] of their discs in radians. Each is larger than the one before it by a
            constant ratio, and from the level `dense_from` (at least 1) on by the square root of this ratio.
        detail: [D, 2 D, 3], with more rows than the first level: the color in each direction divided by its mean over the
            narrowest disc. Cones narrower than this disc are multiplied by it.
        shell_radii: [K], the sky's may be inf; occupied: [K] bool, whether a shell is looked up;
            far: [K] in 0..1, share of the detail.
        origins, directions: [n, 3]; near: [n], shells nearer than this distance are left out, except the last; half_angle:
            [n] radians.
    """
    out = np.empty((len(origins), 4), np.float32)
    near = (near - 1e-4).clamp(min=0)
    cones = [part.detach().cpu().float() for part in (origins, directions, near, half_angle)]
    order = _neighbors_first(cones[1], cones[3], radii[1] / radii[0])
    _composite(
        levels,
        np.asarray(radii, np.float64),
        float(dense_from),
        detail,
        shell_radii.double().clamp(max=SKY_RADIUS).numpy(),
        occupied.numpy(),
        far.double().numpy(),
        _Cones(*(part.contiguous().numpy() for part in (*cones, order))),
        out,
        16 * numba.get_num_threads(),
    )
    return torch.from_numpy(out).to(origins.device)
