"""Finds photos that were taken in another light than most, such as those of an evening with lamps.

An object reflects the light that is there. So photos in two lights fit no single light, and one group must be left out.

Photos are a group of candidates where their white balance has a gap to that of the others, or where a pause lies between
them and the others. A group was taken in another light if two things hold. Its white balance is another one. And the
surroundings differ between the groups, after gains, by more than they differ within the groups, because shadows and bright
sides are elsewhere. White balance alone is no proof: a camera may have changed it.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

import numpy as np

from blender_nep.capture.exposure.sessions import sessions
from blender_nep.capture.exposure.surroundings import Comparison
from blender_nep.capture.loading import MINIMUM_VIEWS

COLOR_GAP = 0.5
"""Photos are two groups where the logarithms of red to blue have such a gap. Measured on one series of photographs: 1.0
between daylight and lamps; the largest step within daylight was 0.1."""
LEAST_APART, DEVIATIONS_APART = 0.3, 3.0
"""The white balance of a group is another one if its logarithm of red to blue, as a median, differs from that of the main
group by the first, and by so many of the deviations within the groups. Measured on the same series: 1.8 and 6."""
CONTRAST = 1.2
"""... and the surroundings must differ between the groups by this multiple of how much they differ within them. Measured on
the same series: 1.8 and 2.6 between lamps and two days of daylight, 1.0 between these days. In one light: 0.7 to 1.2 if both
groups have cameras on all sides, and up to 2.2 where all cameras of a group are close together."""
LEAST_CELLS = 300
"""Groups are compared if they share at least so many cells of the surroundings."""
_CALM = 0.25
"""Cells count whose photos of each group agree best: this share of them. In the others, the distance is wrong."""


def other_light(compared: Comparison, times: Sequence[datetime | None]) -> tuple[int, ...]:
    """The photos that were taken in another light than most, rising; empty if all were taken in one light.

    Empty, too, if the others are fewer than MINIMUM_VIEWS, from which nothing can be learned. times: when each photo was
    taken; None where nobody knows.
    """
    by_color, by_time = _groups_by_color(compared.log), sessions(times)
    labels = by_color * (by_time.max() + 1) + by_time
    others = [np.flatnonzero(labels == label) for label in np.unique(labels)]
    others.sort(key=len, reverse=True)
    main = others.pop(0)
    while same := [group for group in others if not _differs(compared, main, group)]:
        main = np.concatenate([main, *same])
        others = [group for group in others if not any(group is one for one in same)]
    if len(main) < MINIMUM_VIEWS:
        return ()
    return tuple(sorted(int(photo) for group in others for photo in group))


def _groups_by_color(log: np.ndarray) -> np.ndarray:
    """The group [n] of each photo by its white balance, from the logarithms [n, 3] of the gains."""
    balance = log[:, 0] - log[:, 2]
    order = balance.argsort()
    groups = np.zeros(len(log), int)
    groups[order[1:]] = np.cumsum(np.diff(balance[order]) > COLOR_GAP)
    return groups


def _differs(compared: Comparison, main: np.ndarray, group: np.ndarray) -> bool:
    """Whether the light of a group of photos is clearly another one than that of the main group."""
    one, other = (compared.log[photos, 0] - compared.log[photos, 2] for photos in (main, group))
    off_median = np.concatenate([one - np.median(one), other - np.median(other)])
    usual = 1.4826 * float(np.median(np.abs(off_median)))
    if abs(np.median(one) - np.median(other)) < max(LEAST_APART, DEVIATIONS_APART * usual):
        return False
    contrast = _contrast(compared, main, group)
    return contrast is not None and contrast > CONTRAST


def _contrast(compared: Comparison, one: np.ndarray, other: np.ndarray) -> float | None:
    """How much the surroundings differ between two groups of photos, as a multiple of how much they differ within them.

    None if the groups share too few cells.
    """
    (count, mean, deviation), (count_2, mean_2, deviation_2) = (_statistics(compared, group) for group in (one, other))
    both = (count >= 2) & (count_2 >= 2)
    if both.sum() < LEAST_CELLS:
        return None
    within = (deviation + deviation_2)[both] / 2
    calm = within <= np.quantile(within, _CALM)
    between = np.abs(mean - mean_2)[both].mean(1)
    return float(np.median(between[calm]) / max(np.median(within[calm]), 1e-6))


def _statistics(compared: Comparison, group: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of each cell: how many photos of the group show it [c], its mean color [c, 3], and the standard deviation [c]."""
    view, cell, value = compared.evened_cells
    chosen = np.isin(view, group)
    cells = int(cell.max()) + 1
    count = np.bincount(cell[chosen], minlength=cells)
    mean, square = (
        np.stack([np.bincount(cell[chosen], column, cells) for column in (value[chosen] ** power).T], 1)
        / np.maximum(count, 1)[:, None]
        for power in (1, 2)
    )
    sample = count / np.maximum(count - 1, 1)
    return count, mean, np.sqrt(np.maximum(square - mean**2, 0) * sample[:, None]).mean(1)
