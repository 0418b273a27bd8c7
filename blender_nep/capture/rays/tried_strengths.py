"""The strength of a response curve, from errors at several strengths and from what the photo files make likely."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

LEAST_STRENGTH = 0.05
"""Weaker curves are left out."""


@dataclass(frozen=True)
class TriedStrengths:
    """How well the photos are explained under several strengths of the curve."""

    strengths: tuple[float, ...]
    """Rising, and evenly spaced"""
    errors: tuple[float, ...]

    def best(self, expected: float, prior: float) -> float:
        """The strength with the least cost: the error as a multiple of the least one, plus prior * (strength - expected)^2.

        It is refined by a parabola through three strengths, and 0 if it is below `LEAST_STRENGTH`.
        """
        strengths = np.array(self.strengths)
        cost = np.array(self.errors) / min(self.errors) + prior * (strengths - expected) ** 2
        k = int(np.clip(cost.argmin(), 1, len(cost) - 2))
        left, middle, right = cost[k - 1 : k + 2]
        bend = left - 2 * middle + right
        shift = np.clip(0.5 * (left - right) / bend, -1, 1) if bend > 1e-12 else np.sign(left - right)
        found = float(np.clip(strengths[k] + shift * (strengths[1] - strengths[0]), strengths[0], strengths[-1]))
        return found if found >= LEAST_STRENGTH else 0.0

    def rounded(self) -> dict[str, float]:
        """{strength: error} for a report."""
        return {f"{strength:g}": round(error, 5) for strength, error in zip(self.strengths, self.errors, strict=True)}
