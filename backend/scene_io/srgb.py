"""The sRGB curve (IEC 61966-2-1) on numpy arrays, in float64 where the input is.

blender_nep/color.py has the same two functions for the engine. Blender's Python does not import the library.
"""

import numpy as np


def srgb_to_linear(x: np.ndarray) -> np.ndarray:
    """sRGB-encoded values to linear ones."""
    return np.where(x <= 0.04045, x / 12.92, ((np.maximum(x, 0) + 0.055) / 1.055) ** 2.4)


def linear_to_srgb(x: np.ndarray) -> np.ndarray:
    """Linear values, clipped to 0..1, to sRGB-encoded ones: what Blender's view transform Standard does to Rec.709."""
    x = np.clip(x, 0, 1)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
