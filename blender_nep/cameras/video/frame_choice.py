"""Chooses frames of a video: evenly spaced in view, and the sharpest of each step.

How far the view has moved is told by the shifts of blocks of a small picture (phase correlation; Kuglin and Hines 1975)
against a reference frame. When the view has moved by a few percent, the frame becomes the next reference. So the noise of a
camera that stands still adds up to nothing, and a pause gives one frame and not a hundred.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import scipy.fft
from numpy.lib.stride_tricks import sliding_window_view

SHARPNESS_SIDE, MOTION_SIDE = 960, 160
"""Longest side, in pixels, of the pictures in which sharpness and motion are measured"""
_BLOCK, _STRIDE = 32, 24
"""Pixels of the small picture: side of a block, and distance of neighboring ones"""
_NEXT_REFERENCE = 0.03
"""Motion, as a part of the longest side, after which a frame becomes the reference"""
_JUMP = 0.05
"""Motion that is assumed where blocks cannot be found again, such as at a cut"""
_CONTRAST = 2.0
"""Standard deviation, in gray levels, from which on a block can be found again"""
_FOUND = 0.28
"""Least peak of the phase correlation of a block that is found again; unrelated blocks of noise have 0.18, at most 0.26."""
_LEAST_STEP = 0.02
"""Motion between two frames below which a further frame shows nothing new"""
_CENTRAL = 0.3
"""The sharpest frame is sought within this part of a step on both sides of the step's middle."""
_COARSE = 4
"""Pixels of a block whose mean is a pixel of the coarse picture that sharpness is relative to"""


@dataclass
class FrameSurvey:
    """What was measured of the frames so far: one number for each frame and measure."""

    moved: list[float] = field(default_factory=list)
    """How far the view has moved since the first frame, in longest sides of the picture. It never shrinks."""
    steps: list[float] = field(default_factory=list)
    """Motion since the frame before, in the same unit"""
    sharpness: list[float] = field(default_factory=list)
    """How much of the contrast is fine, relative to the coarse contrast of the same frame"""
    _reference: _Blocks | None = None
    _before: _Blocks | None = None
    _base: float = 0.0

    def add(self, large: np.ndarray, small: np.ndarray) -> None:
        """Measure the next frame: its brightness [h, w] uint8 with sides of SHARPNESS_SIDE, and of MOTION_SIDE, at most."""
        self.sharpness.append(sharpness(large))
        blocks = _blocks(small)
        longest = max(small.shape)
        if self._reference is None or self._before is None:
            self._reference = self._before = blocks
            self.moved.append(0.0)
            self.steps.append(0.0)
            return
        self.steps.append(_motion(self._before, blocks) / longest)
        away = _motion(self._reference, blocks) / longest
        self.moved.append(max(self.moved[-1], self._base + away))
        if away >= _NEXT_REFERENCE:
            self._reference, self._base = blocks, self.moved[-1]
        self._before = blocks

    def choose(self, most: int) -> list[int]:
        """Numbers of at most `most` frames, in their order. Where the view moves little, they are fewer."""
        if not self.moved:
            return []
        moved, sharp = np.array(self.moved), np.array(self.sharpness)
        count = min(most, len(moved), 1 + int(moved[-1] / _LEAST_STEP))
        chosen = set()
        for middle in moved[-1] * (np.arange(count) + 0.5) / count:
            reach = _CENTRAL * moved[-1] / count
            first = int(np.searchsorted(moved, middle - reach, "left"))
            end = int(np.searchsorted(moved, middle + reach, "right"))
            if first >= end:  # a quick pan
                first = int(np.abs(moved - middle).argmin())
                end = first + 1
            chosen.add(int(first + sharp[first:end].argmax()))
        return sorted(chosen)


def sharpness(gray: np.ndarray) -> float:
    """Fine contrast relative to coarse contrast of a picture [h, w]: a texture alone makes no frame sharper."""
    fine = gray.astype(np.float32)
    height, width = (side - side % _COARSE for side in gray.shape)
    coarse = fine[:height, :width].reshape(height // _COARSE, _COARSE, width // _COARSE, _COARSE).mean((1, 3))
    return _contrast(fine) / (_contrast(coarse) + 1.0)


def _contrast(gray: np.ndarray) -> float:
    """Mean square of the differences of neighboring pixels"""
    return float((np.diff(gray, axis=0) ** 2).mean() + (np.diff(gray, axis=1) ** 2).mean())


@dataclass(frozen=True)
class _Blocks:
    """The blocks of a small picture."""

    spectra: np.ndarray
    """[n, _BLOCK, _BLOCK // 2 + 1] complex64"""
    usable: np.ndarray
    """[n] whether a block has enough contrast to be found again"""


def _blocks(small: np.ndarray) -> _Blocks:
    """The blocks of a picture [h, w] uint8, without their means, faded out at their borders."""
    missing = [max(0, _BLOCK - side) for side in small.shape]
    small = np.pad(small.astype(np.float32), [(0, missing[0]), (0, missing[1])], mode="reflect")
    blocks = sliding_window_view(small, (_BLOCK, _BLOCK))[::_STRIDE, ::_STRIDE].reshape(-1, _BLOCK, _BLOCK)
    faded = (blocks - blocks.mean((1, 2), keepdims=True)) * (_WINDOW[:, None] * _WINDOW)
    return _Blocks(scipy.fft.rfft2(faded), blocks.std((1, 2)) > _CONTRAST)


def _motion(one: _Blocks, other: _Blocks) -> float:
    """Mean shift in pixels between the blocks of two pictures. Where they cannot be found again: `_JUMP` of MOTION_SIDE."""
    usable = one.usable & other.usable
    if not usable.any():
        return 0.0
    cross = one.spectra[usable] * np.conj(other.spectra[usable])
    cross *= _LOW_PASS / np.maximum(np.abs(cross), 1e-6)
    peaks = scipy.fft.irfft2(cross, s=(_BLOCK, _BLOCK)) / _LOW_PASS_PEAK
    flat = peaks.reshape(len(peaks), -1)
    best = flat.argmax(1)
    found = flat[np.arange(len(flat)), best] > _FOUND
    if found.mean() < 0.5:
        return _JUMP * MOTION_SIDE
    y, x = np.unravel_index(best[found], (_BLOCK, _BLOCK))
    shift_y, shift_x = _finer(peaks[found], y, x)
    return float(np.hypot(shift_y, shift_x).mean())


def _finer(peaks: np.ndarray, y: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The shifts with fractions of a pixel: the vertex of a parabola through the peak and its neighbors."""
    number = np.arange(len(peaks))
    shifts = []
    for axis, place in enumerate((y, x)):
        before, at, after = (
            peaks[number, (y + d) % _BLOCK, x] if axis == 0 else peaks[number, y, (x + d) % _BLOCK] for d in (-1, 0, 1)
        )
        curved = before - 2 * at + after
        offset = np.where(curved < 0, 0.5 * (before - after) / np.minimum(curved, -1e-9), 0.0)
        whole = np.where(place > _BLOCK // 2, place - _BLOCK, place)
        shifts.append(whole + offset.clip(-0.5, 0.5))
    return shifts[0], shifts[1]


_WINDOW = np.hanning(_BLOCK).astype(np.float32)
_LOW_PASS = np.exp(
    -0.5 * ((np.fft.fftfreq(_BLOCK)[:, None] / 0.2) ** 2 + (np.fft.rfftfreq(_BLOCK)[None, :] / 0.2) ** 2)
).astype(np.float32)
"""Weights of the frequencies: the finest ones are mostly noise."""
_LOW_PASS_PEAK = float(np.fft.irfft2(_LOW_PASS, s=(_BLOCK, _BLOCK)).max())
"""The peak where both blocks are equal"""
