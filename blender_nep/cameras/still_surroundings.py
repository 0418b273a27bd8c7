"""Tells before structure from motion whether the photos are from a turntable, and what turns in them.

On a turntable the surroundings stay where they are in the photos. Structure from motion would find the cameras relative to
them: all at one place. So only what turns may count. No camera is known yet, so the photos themselves are compared: their
details, without the smooth parts that exposures and backdrops differ in. Two photos of a row show the same details at equal
places, but for the object. Two photos of a walk do not, and photos of a plain backdrop have no details there.

A photo may be cropped, so that its surroundings are shifted. Along an arc before a far background they are shifted, too, but
more and more from photo to photo.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.sparse.csgraph import connected_components

from blender_nep.cameras.photo_folder import Photo, gray_copy
from blender_nep.cameras.reduction import Reduction

SIDE = 192
"""Pixels of the longer side of the copies that are compared"""
SMOOTH = 6.0
"""Pixels of a copy. Details are what a Gaussian filter of this width takes away."""
PARTNERS = 20
"""Each photo is compared with about so many others, from all parts of the sequence."""
MOST_ALIKE = 0.4
"""Of the places of two photos that have details, the differences of this share count, the smallest ones. The object may
take the others."""
LEAST_DETAIL = 2.0
"""Gray values of 255. Where mirrored photos differ by less, the surroundings are plain."""
SAME = 0.45
"""Two photos show the same surroundings if their details differ by less than this share of what they would differ by, if
one of them were mirrored. Measured: 0.09 to 0.43 for nearly all pairs of a camera that stood still; 0.53 and more for all
pairs of four walks."""
MOST_SHIFT = 0.15
"""Largest shift of the surroundings between two photos, as a share of the longer side"""
DRIFT, DRIFTS = 0.04, 0.7
"""The surroundings drift if the shifts grow with the photos' numbers: by more than the first number from the first photo to
the last, as a share of the longer side, and with a correlation of more than the second number."""
SAME_AS = 0.1
"""A photo's surroundings stand still if this share of the photos that it is compared with show the same, and at least two.
The camera may stand at several heights, and only photos from one height agree: a third of all with three heights, and not
each of these. After four walks, no photo has a partner that shows the same."""
LEAST_STILL = 0.6
"""It is a turntable if this share of the photos have surroundings that stand still."""
RECURS = 0.2
"""A value recurs at a place if at least this share of the photos of a row, and at least three, have it."""
DIFFERS, NOISE = (4.0, 14.0), 2.5
"""Gray values of 255 by which what turns differs from what stands still: within these limits, NOISE times what nine of ten
pixels at the edges of the photos differ by. A print on a plate in the shadow has little contrast."""
EDGE = 0.06
"""The edges are so wide, as a share of the longer side."""
REACH = 3
"""Pixels of a copy. So far around what turns, features count, too. Gaps up to four times as wide are closed."""


@dataclass(frozen=True)
class StillSurroundings:
    """What the photos of a folder show that stands still."""

    share: float
    """Share of the photos whose surroundings stand still; 0 where these drift"""
    shifted: bool
    """Whether the surroundings of some photos are shifted, or the photos have several sizes"""
    moving: list[np.ndarray] | None
    """For each photo, where its copy [h, w] bool shows what turns. None: that is not known, because photos are shifted, or
    because it is no turntable"""
    drift: bool = False
    """Whether most surroundings are the same, but drift from photo to photo: after a walk before a far background, and on a
    turntable where each photo was cropped around the object"""

    @property
    def turntable(self) -> bool:
        """Whether the photos are from a turntable."""
        return self.share >= LEAST_STILL


def look_for_still_surroundings(
    photos: Sequence[Photo], report: Callable[[int, int], None] = lambda step, steps: None
) -> StillSurroundings:
    """Compare the photos with each other. Raises CaptureError where one cannot be read. Takes 0.1 s a photo.

    report(step, steps) is called twice for each photo: when it is read, and when it is compared. It may raise to end this.
    """
    copies = []
    for number, photo in enumerate(photos):
        report(number, 2 * len(photos))
        copies.append(gray_copy(photo, Reduction.of(photo.width, photo.height, SIDE)).astype(np.float32))
    details = [copy - ndimage.gaussian_filter(copy, SMOOTH) for copy in copies]
    count = len(photos)
    same = np.zeros((count, count), bool)
    shifts: list[tuple[int, int, int]] = []
    step = max(1, count // PARTNERS)
    agreeing, compared = np.zeros((2, count), int)
    for one in range(count):
        report(count + one, 2 * count)
        for other in range((one + step) % step, count, step):
            if other == one or details[one].shape != details[other].shape:
                continue
            compared[one] += 1
            alike, shift = _same(details[one], details[other])
            if alike:
                agreeing[one] += 1
                same[one, other] = same[other, one] = True
                shifts.append((other - one, *shift))
    still = (agreeing >= 2) & (agreeing >= SAME_AS * compared)
    share = float(still.mean())
    if _drift(np.array(shifts, float).reshape(-1, 3), count):
        return StillSurroundings(0.0, True, None, share >= LEAST_STILL)
    shifted = (
        any(max(abs(rows), abs(columns)) > 1 for _, rows, columns in shifts) or len({copy.shape for copy in copies}) > 1
    )
    if share < LEAST_STILL or shifted:
        return StillSurroundings(share, shifted, None)
    return StillSurroundings(share, False, _moving(np.stack(copies), same))


def _drift(shifts: np.ndarray, count: int) -> bool:
    """Whether the surroundings drift in `count` photos. shifts [n, 3]: difference of two numbers, rows, columns."""
    apart, size = shifts[:, 0], np.linalg.norm(shifts[:, 0])
    for shift in shifts[:, 1:].T:
        product = float(apart @ shift)
        if abs(product) * count > DRIFT * SIDE * size**2 and abs(product) > DRIFTS * size * np.linalg.norm(shift):
            return True
    return False


def _same(one: np.ndarray, other: np.ndarray) -> tuple[bool, tuple[int, int]]:
    """Whether two photos show the same surroundings by their details [h, w], and the shift (rows, columns) of the other."""
    shift = _shift(one, other)
    equal = _difference(one, other, shift)
    mirrored = min(_difference(one, other[::-1], (0, 0)), _difference(one, other[:, ::-1], (0, 0)))
    return mirrored > LEAST_DETAIL and equal < SAME * mirrored, shift


def _shift(one: np.ndarray, other: np.ndarray) -> tuple[int, int]:
    """The shift (rows, columns) by which the other photo's details [h, w] fit best: by phase correlation."""
    product = np.fft.rfft2(one) * np.conj(np.fft.rfft2(other))
    found = np.fft.irfft2(product / np.maximum(np.abs(product), 1e-6), one.shape)
    most = int(MOST_SHIFT * max(one.shape))
    near = np.full(one.shape, -np.inf)
    for rows in (slice(0, most + 1), slice(-most, None)):
        for columns in (slice(0, most + 1), slice(-most, None)):
            near[rows, columns] = found[rows, columns]
    row, column = np.unravel_index(near.argmax(), near.shape)
    height, width = one.shape
    return int((row + height // 2) % height - height // 2), int((column + width // 2) % width - width // 2)


def _difference(one: np.ndarray, other: np.ndarray, shift: tuple[int, int]) -> float:
    """Mean of the smallest differences of two photos' details [h, w], after the other is shifted."""
    rows, columns = shift
    height, width = one.shape
    here = one[max(rows, 0) : height + min(rows, 0), max(columns, 0) : width + min(columns, 0)]
    there = other[max(-rows, 0) : height + min(-rows, 0), max(-columns, 0) : width + min(-columns, 0)]
    difference, detail = np.abs(here - there).ravel(), (np.abs(here) + np.abs(there)).ravel()
    difference = difference[detail >= np.median(detail)]  # a place without details looks like any other one
    kept = max(1, int(MOST_ALIKE * difference.size))
    return float(np.partition(difference, kept - 1)[:kept].mean())


def _moving(copies: np.ndarray, same: np.ndarray) -> list[np.ndarray]:
    """Where each of the copies [n, h, w] shows what turns: what does not have the value that recurs there in its row."""
    moving: list[np.ndarray] = [np.ones(copies.shape[1:], bool)] * len(copies)
    width = max(1, round(EDGE * max(copies.shape[1:])))
    edges = np.ones(copies.shape[1:], bool)
    edges[width:-width, width:-width] = False
    count, labels = connected_components(same, directed=False)
    for label in range(int(count)):
        row = np.flatnonzero(labels == label)
        if len(row) < 3:
            continue
        values = copies[row]
        usual = np.maximum(np.median(values[:, edges], axis=0), 1)
        exposure = np.median(values[:, edges] / usual, axis=1)
        values = values / np.maximum(exposure, 0.1)[:, None, None]
        needed = max(3, round(RECURS * len(row)))
        tried = values[:: max(1, len(row) // 16)]
        spreads = np.stack([np.partition(np.abs(values - one), needed - 1, axis=0)[needed - 1] for one in tried])
        color = np.take_along_axis(tried, spreads.argmin(0)[None], 0)[0]
        limit = float(np.clip(NOISE * np.quantile(np.abs(values - color)[:, edges], 0.9), *DIFFERS))
        unknown = spreads.min(0) > limit
        for photo, value in zip(row, values, strict=True):
            differs = ndimage.median_filter((np.abs(value - color) > limit) | unknown, 3)
            rim = 2 * REACH
            closed = ndimage.binary_fill_holes(ndimage.binary_closing(np.pad(differs, rim), iterations=rim))
            moving[photo] = ndimage.binary_dilation(closed, iterations=REACH)[rim:-rim, rim:-rim]
    return moving
