"""The sRGB curve (IEC 61966-2-1) on numpy arrays. The result is float64 where the input is float64.

blender_nep/color.py has the same two functions for the engine. They stand here a second time, because Blender's Python does
not import the library.
"""

import numpy as np


def srgb_to_linear(x: np.ndarray) -> np.ndarray:
    """Turn sRGB-encoded values into linear ones."""
    return np.where(x <= 0.04045, x / 12.92, ((np.maximum(x, 0) + 0.055) / 1.055) ** 2.4)


def linear_to_srgb(x: np.ndarray) -> np.ndarray:
    """Turn linear values, clipped to 0..1, into sRGB-encoded ones.

    Blender's view transform Standard does the same to Rec.709 values.
    """
    x = np.clip(x, 0, 1)
    return np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)
