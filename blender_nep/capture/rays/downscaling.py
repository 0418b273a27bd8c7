"""Scales photos down by a whole number."""

from __future__ import annotations

import math

import numpy as np


def factor_for(height: int, width: int, most: int) -> int:
    """The smallest whole number by which a photo is scaled down to at most `most` pixels, but never to no pixel."""
    factor = max(1, math.ceil(math.sqrt(height * width / most) - 1e-9))
    while factor > 1 and min(height, width) < factor:
        factor -= 1
    return factor


def box(pixels: np.ndarray, factor: int) -> np.ndarray:
    """Means over blocks of factor x factor pixels of [H, W, C]. Pixels left over at the right and the bottom are dropped."""
    if factor == 1:
        return pixels
    height, width = pixels.shape[0] // factor, pixels.shape[1] // factor
    total = np.zeros((height, width, pixels.shape[2]), np.float32)
    for i in range(factor):  # strided sums are ten times faster than a mean over two axes of a reshaped view
        for j in range(factor):
            total += pixels[i : height * factor : factor, j : width * factor : factor]
    return total / factor**2
