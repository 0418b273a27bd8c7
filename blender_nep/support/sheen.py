"""The sheen of the support plane: how much brighter, and of what other color, it looks from one side than from another.

Carpets and cloth that a window lights are brighter and less colorful against the light and seen flatly. A texture with one
color a texel does not know this. The object mostly sees its table flatly, and the photos mostly see the table from above.
So the logarithm of the radiance that a point of the plane sends towards d is, in each channel, that of its texel, plus a
linear function of d. This is the first order of spherical harmonics of the logarithm: nine numbers for the whole plane.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

BLACK = 0.003
"""Radiance that is added before a logarithm is taken, so that noise in the dark does not count."""
MOST = 1.1
"""Largest size of the logarithm of the sheen: a factor of three"""
LEAST_GAIN = 0.1
"""The sheen counts if it lowers the difference of photos that it was not fitted to from their texels by this share."""
_PRIOR = 0.001
"""Weight of the guess that there is no sheen, as a share of the observations"""
_ITERATIONS = 4
"""Rounds of reweighted least squares"""
_SMALLEST = 0.05
"""Logarithms that differ by less count as equal."""
_LEAST_VIEWS = 4
"""Fewer photos tell nothing of the sheen."""


@dataclass(frozen=True, eq=False)
class Sheen:
    """Factors of the plane's radiance, by the direction into which it goes."""

    slope: Tensor
    """[3, 3]: change of the logarithm of each channel (columns) along each axis of the unit frame (rows)"""

    @classmethod
    def of(cls, colors: Tensor, towards: Tensor) -> Sheen | None:
        """The sheen of n points in V photos. None if there is none that explains photos to which it was not fitted.

        colors [V, n, 3] linear, NaN where a photo does not show a point; towards [V, n, 3] unit vectors to the cameras.
        """
        if len(colors) < _LEAST_VIEWS:
            return None
        shown = torch.isfinite(colors[..., 0])
        log = (torch.where(shown[..., None], colors, 0.0).clamp_min(0) + BLACK).log()
        log, direction = _about_means(log, shown), _about_means(towards, shown)
        halves = [shown & (torch.arange(len(shown), device=shown.device) % 2 == k)[:, None] for k in (0, 1)]
        if not all(bool(half.any()) for half in halves):
            return None
        left = torch.stack([_left(log, direction, halves[1 - k], _fitted(log, direction, halves[k])) for k in (0, 1)])
        before = torch.stack([_left(log, direction, half, torch.zeros(3, 3).to(log)) for half in halves])
        if float(left.sum()) > (1 - LEAST_GAIN) * float(before.sum()):
            return None
        return cls(_fitted(log, direction, shown))

    def factor(self, towards: Tensor) -> Tensor:
        """The factor [..., 3] of the radiance that goes into the directions `towards` [..., 3]."""
        return (towards @ self.slope).clamp(-MOST, MOST).exp()

    def scaled(self, power: Tensor) -> Sheen:
        """The sheen whose factors are those of this one to the `power` [3] of each channel."""
        return Sheen(self.slope * power)


def _about_means(values: Tensor, shown: Tensor) -> Tensor:
    """The values [V, n, 3] without the mean over the photos that show each point; 0 where `shown` [V, n] is False."""
    weight = shown[..., None].to(values.dtype)
    mean = (values * weight).sum(0) / weight.sum(0).clamp_min(1)
    return (values - mean) * weight


def _fitted(log: Tensor, direction: Tensor, shown: Tensor) -> Tensor:
    """The slope [3, 3] with the least absolute differences, by reweighted least squares. All are sums over the photos."""
    y, x = log[shown].double(), direction[shown].double()
    slope = torch.zeros(3, 3, dtype=torch.float64, device=y.device)
    for _ in range(_ITERATIONS):
        weight = _SMALLEST / (y - x @ slope).abs().clamp_min(_SMALLEST)
        for k in range(3):
            scaled = x * weight[:, k, None]
            normal = scaled.T @ x + _PRIOR * len(x) * torch.eye(3).to(x)
            slope[:, k] = torch.linalg.solve(normal, scaled.T @ y[:, k])
    return slope.to(log.dtype)


def _left(log: Tensor, direction: Tensor, shown: Tensor, slope: Tensor) -> Tensor:
    """Mean absolute difference of the photos `shown` [V, n] from their texels, with this slope."""
    return (log[shown] - direction[shown] @ slope).abs().mean()
