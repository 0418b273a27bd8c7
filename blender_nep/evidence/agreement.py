"""The ways in which photos agree on the color of a point.

Colors [views, n, 3] are those of n points in all photos; NaN where a photo does not show a point (`observation.colors_of`).
A point of a dull surface has the same color in all photos that show it. A wrong point falls on another place in each photo.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from blender_nep.evidence.observation import Observation

ALIKE = 0.04
"""Tone-mapped difference up to which two photos agree on a color."""
_CHUNK = 512
"""Points whose photos are compared in pairs at a time."""


def views_that_show(colors: Tensor) -> Tensor:
    """The number [n] of photos that show each point, of colors [views, n, 3]."""
    return torch.isfinite(colors[..., 0]).sum(0)


def median_of_photos(colors: Tensor) -> Tensor:
    """The median color [n, 3] of colors [views, n, 3]; NaN where no photo shows the point."""
    return colors.nanmedian(0).values


def difference(colors: Tensor, from_color: Tensor) -> Tensor:
    """How much colors [views, n, 3] differ from one color [n, 3] a point: the median over the photos [n].

    The difference of a photo is the mean of those of its channels.
    """
    return (colors - from_color).abs().mean(-1).nanmedian(0).values


def spread(colors: Tensor) -> Tensor:
    """How much colors [views, n, 3] differ from their median: the median absolute deviation, in the channels' mean [n].

    `difference` takes the mean of the channels first, and then the median over the photos.
    """
    return (colors - median_of_photos(colors)).abs().nanmedian(0).values.mean(-1)


class Majority(NamedTuple):
    """On what most photos agree, for n points."""

    color: Tensor
    """[n, 3] the mean of the photos that agree, tone-mapped; 0 where no photo shows the point"""
    share: Tensor
    """[n] 0..1: how many of the photos that show the point agree"""
    views: Tensor
    """[n] int64: how many photos show the point"""


def majority(colors: Tensor, most_apart: float = ALIKE) -> Majority:
    """The color on which most photos agree, of tone-mapped colors [views, n, 3].

    Two photos agree if the mean difference of their channels is less than most_apart.
    """
    found = []
    for part in colors.split(_CHUNK, 1):
        seen = part.transpose(0, 1)
        shown = torch.isfinite(seen[..., 0])
        alike = (seen[:, :, None] - seen[:, None]).abs().mean(-1) < most_apart  # False for NaN
        most, best = alike.sum(2).max(1)
        chosen = alike[torch.arange(len(seen), device=seen.device), best]
        color = torch.where(chosen[..., None], seen, 0.0).sum(1) / most.clamp_min(1)[:, None]
        views = shown.sum(1)
        found.append((color, most / views.clamp_min(1), views))
    return Majority(*(torch.cat(values) for values in zip(*found, strict=True)))


def variation(observations: Iterable[Observation], count: int) -> tuple[np.ndarray, np.ndarray]:
    """How much the brightness of `count` points varies from photo to photo, and how many photos show each: [n], [n] float64.

    The variation is the standard deviation divided by the mean; 0 where no photo shows the point. The photos may be many:
    they are not held in memory.
    """
    shown, total, square = (np.zeros(count) for _ in range(3))
    for seen in observations:
        index, value = seen.index.cpu().numpy(), seen.color.mean(-1).cpu().numpy()
        shown[index] += 1
        total[index] += value
        square[index] += value.astype(np.float64) ** 2
    mean = total / np.maximum(shown, 1)
    deviation = np.sqrt(np.maximum(square / np.maximum(shown, 1) - mean**2, 0))
    return deviation / np.maximum(mean, 1e-6), shown
