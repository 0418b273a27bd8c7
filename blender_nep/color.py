"""Converts arrays [...] between linear, sRGB-encoded and 8-bit values.

Blender's own Python cannot import this package. `backend/scene_io/srgb.py` is a copy for Blender.
"""

from __future__ import annotations

import numpy as np


def srgb_to_linear(x: np.ndarray) -> np.ndarray:
    """Convert sRGB-encoded values in [0, 1] to linear values, float32 (IEC 61966-2-1)."""
    return np.where(x <= 0.04045, x / 12.92, ((np.maximum(x, 0.04045) + 0.055) / 1.055) ** 2.4).astype(np.float32)


def linear_to_srgb(x: np.ndarray) -> np.ndarray:
    """Convert linear values, clipped to [0, 1], to sRGB-encoded values, float32 (IEC 61966-2-1)."""
    x = np.clip(x, 0.0, 1.0)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 0.0031308) ** (1 / 2.4) - 0.055).astype(np.float32)


def to_bytes(values: np.ndarray) -> np.ndarray:
    """Convert values in [0, 1] to uint8 0..255, rounded. Values outside are clipped; NaN becomes 0."""
    return np.round(255 * np.clip(np.nan_to_num(values), 0, 1)).astype(np.uint8)
