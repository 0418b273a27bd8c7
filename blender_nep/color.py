"""The sRGB transfer function and 8-bit values, of arrays [...].

Blender's own Python cannot import this package: `backend/scene_io/srgb.py` holds a second copy for it.
"""

from __future__ import annotations

import numpy as np


def srgb_to_linear(x: np.ndarray) -> np.ndarray:
    """sRGB-encoded values in [0, 1] to linear (IEC 61966-2-1)."""
    return np.where(x <= 0.04045, x / 12.92, ((np.maximum(x, 0.04045) + 0.055) / 1.055) ** 2.4).astype(np.float32)


def linear_to_srgb(x: np.ndarray) -> np.ndarray:
    """Linear values to sRGB-encoded ones, both clipped to [0, 1] (IEC 61966-2-1)."""
    x = np.clip(x, 0.0, 1.0)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 0.0031308) ** (1 / 2.4) - 0.055).astype(np.float32)


def to_bytes(values: np.ndarray) -> np.ndarray:
    """[0, 1] to 0..255, rounded; values outside are clipped, NaN becomes 0."""
    return np.round(255 * np.clip(np.nan_to_num(values), 0, 1)).astype(np.uint8)
