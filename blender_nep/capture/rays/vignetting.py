"""Vignetting: photos that grow darker towards their corners.

A lens lets less light through to the corners of a photo. The logarithm of this loss is a polynomial in the distance from the
photo's middle. (Goldman and Chen, Vignette and exposure calibration and compensation, ICCV 2005, use a polynomial for the
gain.) Its coefficients are found together with the exposures, in closed form: see `exposure`.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

TERMS = 2
"""Number of terms of the polynomial: r^2 and r^4"""
_MOST_BELOW_CORNERS = 1.2
"""The darkest ring's logarithm is at most this many times that of the corners."""


def falloff_terms(square: Tensor) -> Tensor:
    """The polynomial's terms [n, TERMS] at squared distances [n] from the middle, in half diagonals of the photo."""
    return torch.stack([square, square**2], -1)


@dataclass(frozen=True)
class Vignetting:
    """How much darker photos are away from their middle."""

    square: float
    """Coefficient of r^2 in the logarithm of the gain, where r = 1 at a corner"""
    fourth: float
    """Coefficient of r^4"""

    def at(self, square: Tensor) -> Tensor:
        """Gain [n] at squared distances [n] from the middle: 1 in the middle, less towards the corners."""
        return (falloff_terms(square) @ square.new_tensor([self.square, self.fourth])).exp()

    @property
    def corner_stops(self) -> float:
        """Stops by which the corners are brighter than the middle; negative where they are darker."""
        return float(self.at(torch.ones(1, dtype=torch.float64)).log2())

    @property
    def darkest_at_corners(self) -> bool:
        """Whether photos are nowhere much darker than in their corners. No lens makes a dark ring around a brighter rim.

        A fit to a lens whose rim is flat may turn up a little there: a fifth of the logarithm is allowed.
        """
        ring = self.at(torch.linspace(0, 1, 101, dtype=torch.float64)).log()
        return bool((ring >= _MOST_BELOW_CORNERS * ring[-1].clamp(max=0)).all())
