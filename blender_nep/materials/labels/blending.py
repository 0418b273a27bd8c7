"""Finds how much of each of two materials a place shows: the share in steps of a quarter, refined by a parabola."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from blender_nep.materials.baking import LabeledPoints
from blender_nep.materials.palette.palette import SHARES, Palette


@dataclass
class BlendedPoints:
    """n points of the surface, each with a blend of two materials of a palette. Most points show one material alone."""

    position: np.ndarray
    """[n, 3] unit frame"""
    normal: np.ndarray
    """[n, 3] unit vectors"""
    photo: np.ndarray
    """[n] int, index of the photo that shows the point"""
    residual: np.ndarray
    """[n] residual of the point's material"""
    first: np.ndarray
    """[n] int64, index of the first material"""
    second: np.ndarray
    """[n] int64, index of the second material"""
    share: np.ndarray
    """[n] in 0..1, share of the second material"""

    def labeled(self, palette: Palette) -> LabeledPoints:
        """The points with the materials of a palette. It may have blends; they are not used."""

        def mixed(values: np.ndarray) -> np.ndarray:
            part = self.share.reshape(-1, *[1] * (values.ndim - 1))
            return values[self.first] * (1 - part) + values[self.second] * part

        albedo, roughness, metallic = (x.cpu().numpy() for x in (palette.albedo, palette.roughness, palette.metallic))
        material = mixed(albedo), mixed(roughness), mixed(metallic)
        return LabeledPoints(self.position, self.normal, self.photo, *material, self.residual)


def find_blends(cost: np.ndarray, palette: Palette, blend_margin: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The blends of n points: first material [n], second material [n] and share of the second [n].

    cost [n, K + blends] are the residuals of a palette with blends.
    The residuals of blends are raised by the share `blend_margin`. The best material or blend of a point tells which pairs
    are possible. Along each pair, the share is where a parabola through the residuals of three neighboring shares is least.
    The pair with the least minimum is taken.
    """
    pairs = np.array(palette.pairs(), np.int64).reshape(-1, 2)
    best = cost.argmin(1)
    first, second, share = best.copy(), best.copy(), np.zeros(len(best), np.float32)
    least, alone, steps = np.full(len(best), np.inf), len(palette) - palette.blends, len(SHARES)
    for p, (i, j) in enumerate(pairs):
        blends = alone + steps * p + np.arange(steps)
        rows = np.flatnonzero((best == i) | (best == j) | ((best >= blends[0]) & (best <= blends[-1])))
        line = np.concatenate([cost[rows, i, None], cost[np.ix_(rows, blends)] / (1 + blend_margin), cost[rows, j, None]], 1)
        at, value = _least_of_parabola(line)
        better = value < least[rows]
        rows, at = rows[better], at[better]
        least[rows], first[rows], second[rows], share[rows] = value[better], i, j, at / (steps + 1)
    return first, second, share


def _least_of_parabola(line: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where each row of line [n, S] is least, between 0 and S - 1, and its value there.

    A parabola goes through the least value and its two neighbors.
    """
    lowest = line.argmin(1)
    each, at = np.arange(len(line)), np.clip(lowest, 1, line.shape[1] - 2)
    left, middle, right = line[each, at - 1], line[each, at], line[each, at + 1]
    slope, curve = 0.5 * (right - left), left - 2 * middle + right
    bowl = curve > 1e-6
    shift = np.where(bowl, -slope / np.where(bowl, curve, 1), lowest - at).clip(-1, 1)
    return at + shift, middle + slope * shift + 0.5 * curve * shift**2
