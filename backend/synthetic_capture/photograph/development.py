"""What a camera makes of the light that falls on its sensor: pure functions of pixels.

The order is that of a camera: exposure, noise, saturation of the sensor, white balance, the sRGB curve, the camera's own
tone curve, colors, local contrast, sharpening.
"""

from dataclasses import dataclass

import numpy as np

from ...scene_io.srgb import linear_to_srgb

FULL_WELL, READ_NOISE = 60_000, 6.0
"""Electrons of a white pixel at ISO 100, and the standard deviation of reading a pixel, in electrons. A pixel of a photo
that was made smaller has those of several pixels of the sensor."""
LUMA = np.array([0.2126, 0.7152, 0.0722])
LOCAL_RADIUS, SHARPENING_RADIUS = 0.04, 0.9
"""Standard deviations of the blurs behind local contrast (in photo widths) and behind sharpening (in pixels)."""


@dataclass(frozen=True)
class Look:
    """The taste of a camera model. The defaults change nothing."""

    lift: float = 1.0
    """exponent of encoded values; below 1 is brighter"""
    contrast: float = 1.0
    """of the S curve; above 1 is steeper in the middle"""
    saturation: float = 1.0
    local_contrast: float = 0.0
    sharpening: float = 0.0


def noise_variance(signal: np.ndarray, iso: int) -> np.ndarray:
    """Variance of the sensor's signal, of which 1 is white: shot noise of electrons, and noise of reading.

    At ISO 100, white has FULL_WELL electrons; at twice the ISO, half of them.
    """
    white = FULL_WELL * 100 / iso
    return np.maximum(signal, 0) / white + (READ_NOISE / white) ** 2


def noisy(signal: np.ndarray, iso: int, rng: np.random.Generator) -> np.ndarray:
    """The signal with noise of this ISO. It may be below 0."""
    return signal + rng.standard_normal(signal.shape) * np.sqrt(noise_variance(signal, iso))


def s_curve(encoded: np.ndarray, contrast: float) -> np.ndarray:
    """x^c / (x^c + (1 - x)^c): monotone from 0 to 1, its own inverse with 1 / c, with slope c at 0.5."""
    high, low = encoded**contrast, (1 - encoded) ** contrast
    return high / (high + low)


def toned(encoded: np.ndarray, look: Look) -> np.ndarray:
    """The camera's tone curve on sRGB-encoded values in 0..1: brighter shadows and middle tones, then an S."""
    return s_curve(encoded**look.lift, look.contrast)


def saturated(encoded: np.ndarray, factor: float) -> np.ndarray:
    """The pixels [H,W,3] with their distance from gray times `factor`. Luma stays."""
    gray = (encoded @ LUMA)[..., None]
    return gray + factor * (encoded - gray)


def blurred(image: np.ndarray, sigma: float) -> np.ndarray:
    """The image [H,W] under a Gaussian of this standard deviation in pixels. Edge pixels go on beyond the edge."""
    reach = max(1, round(3 * sigma))
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) / sigma) ** 2)
    weights /= weights.sum()
    for axis in (0, 1):
        padded = np.pad(image, [(reach, reach) if axis == k else (0, 0) for k in (0, 1)], mode="edge")
        parts = (np.take(padded, np.arange(image.shape[axis]) + k, axis) * w for k, w in enumerate(weights))
        image = sum(parts)
    return image


def with_detail(encoded: np.ndarray, amount: float, sigma: float) -> np.ndarray:
    """The pixels [H,W,3] plus `amount` times what a blur with `sigma` pixels takes from their luma."""
    luma = encoded @ LUMA
    return encoded + amount * (luma - blurred(luma, sigma))[..., None]


def developed(
    radiance: np.ndarray,
    gain: float,
    balance: tuple[float, float, float] = (1.0, 1.0, 1.0),
    look: Look | None = None,
    iso: int = 100,
    noise: np.random.Generator | None = None,
) -> np.ndarray:
    """The photo of linear radiance [H,W,3]: sRGB-encoded values in 0..1.

    `gain` makes white of radiance, `balance` are the gains of the white balance for R, G and B. `noise`: None for no noise.
    """
    signal = np.asarray(radiance, np.float64) * gain
    if noise is not None:
        signal = noisy(signal, iso, noise)
    encoded = linear_to_srgb(signal.clip(0, 1) * balance)
    if look is None:
        return encoded
    photo = saturated(toned(encoded, look), look.saturation).clip(0, 1)
    photo = with_detail(photo, look.local_contrast, LOCAL_RADIUS * photo.shape[1]).clip(0, 1)
    return with_detail(photo, look.sharpening, SHARPENING_RADIUS).clip(0, 1)
