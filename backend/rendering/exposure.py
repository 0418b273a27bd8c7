"""Finds the exposure of a picture."""

import numpy as np

EXPOSED = 0.65  # the exposure brings a tile's EXPOSED_PERCENTILE of luminance to this part of white
EXPOSED_PERCENTILE = 90


def exposure(radiance: np.ndarray) -> float:
    """The factor that brings the bright parts of an image [...,3] to EXPOSED, just under white.

    The bright parts are the EXPOSED_PERCENTILE of its luminance.
    """
    luminance = radiance @ np.array([0.2126, 0.7152, 0.0722])
    bright = float(np.percentile(luminance, EXPOSED_PERCENTILE))
    return float(np.clip(EXPOSED / max(bright, 1e-6), 1 / 64, 64))
