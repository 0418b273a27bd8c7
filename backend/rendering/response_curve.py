"""What a camera's response curve makes of rendered light: blender_nep/capture/rays/response_curve.py without torch."""

import numpy as np

CONTRAST, SHOULDER = 0.25, 1.7
"""As in the library. tests/backend/rendering/test_response_curve.py compares both."""


def seen_by_camera(light: np.ndarray, curve: tuple[float, float, float] | None) -> np.ndarray:
    """The radiance [...] that a photo shows of light [...] >= 0. curve: strength, white and scale; None: none was found."""
    if curve is None or curve[0] == 0:
        return light
    strength, white, scale = curve
    n, q = 1 + CONTRAST * strength, SHOULDER * strength
    x = light / scale
    power = np.clip(x, 0, 1) ** n
    return white * ((1 + q) * power / (1 + q * power) + np.maximum(x - 1, 0))
