"""Scores how well an asset explains photos, without a truth: pixels as the photos show them, against the asset's.

Nobody knows how bright an asset is beside its light, so each photo has a gain of its own. Photos and asset are compared as
a person sees them: sRGB-encoded and clipped at white, each photo with the exposure that suits it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from blender_nep.asset.preview import exposure
from blender_nep.color import linear_to_srgb

_FEWEST_PIXELS = 8
"""Photos of fewer pixels are left out: a gain of their own would explain much of them."""
_DARK = 0.02
"""The hue of pixels whose brightest channel is darker than this in the photo does not count; white is 1."""
_LEAST_ERROR = 1e-10
"""Mean squared error of the best score, 100 dB"""


@dataclass(frozen=True)
class PhotoScore:
    """How well an asset explains some pixels of photos."""

    psnr: float
    """dB, over all channels of all pixels"""
    hue_deg: float | None
    """Mean angle [degrees] between the colors of photo and asset as vectors of linear RGB. None: all pixels are dark"""
    gains: dict[int, float]
    """{number of the photo: the factor that makes the asset as bright as this photo}"""
    psnr_of_photos: dict[int, float]
    """{number of the photo: dB}"""
    pixels: int
    """Number of pixels that count"""


def photo_score(shown: np.ndarray, asset: np.ndarray, photo: np.ndarray) -> PhotoScore | None:
    """The score of n pixels: linear radiance in the photos, `shown` [n, 3], and that of the asset there, `asset` [n, 3].

    photo [n] int is the number of each pixel's photo. Burnt-out pixels must be left out before. None: no photo has enough
    pixels.
    """
    gains, errors, angles = {}, {}, []
    for number in np.unique(photo).tolist():
        own = photo == number
        if own.sum() < _FEWEST_PIXELS:
            continue
        true, found = shown[own].astype(np.float64), asset[own].astype(np.float64)
        gain = gain_of(true, found)
        bright = exposure(true)
        gains[number] = gain
        errors[number] = ((linear_to_srgb(bright * true) - linear_to_srgb(bright * gain * found)) ** 2).mean(1)
        angles.append(_angles(bright * true, found))
    if not gains:
        return None
    angle = np.concatenate(angles)
    return PhotoScore(
        psnr=_decibels(np.concatenate(list(errors.values()))),
        hue_deg=float(np.degrees(angle.mean())) if len(angle) else None,
        gains=gains,
        psnr_of_photos={number: _decibels(error) for number, error in errors.items()},
        pixels=sum(map(len, errors.values())),
    )


def gain_of(shown: np.ndarray, asset: np.ndarray) -> float:
    """The gain g for which the sum of |shown - g asset| is least; both [n, 3]. 1 where the asset is black.

    Brightness is the sum of the channels. The answer is the median of the ratios, each weighted by the asset's brightness,
    so that a few reflections in the wrong place do not count.
    """
    true, found = shown.sum(1), asset.sum(1)
    lit = found > 0
    if not lit.any() or not true[lit].any():
        return 1.0
    ratio, weight = true[lit] / found[lit], found[lit]
    order = np.argsort(ratio)
    total = np.cumsum(weight[order])
    return float(ratio[order][np.searchsorted(total, total[-1] / 2)]) or 1.0


def _angles(shown: np.ndarray, asset: np.ndarray) -> np.ndarray:
    """Angles [m] in radians between the colors of the pixels [n, 3] that are bright enough; white is 1 in `shown`."""
    counts = (shown.max(1) > _DARK) & (asset.max(1) > 0)
    a, b = (x[counts] / np.linalg.norm(x[counts], axis=1, keepdims=True) for x in (shown, asset))
    return 2 * np.arcsin(np.clip(np.linalg.norm(a - b, axis=1) / 2, 0, 1))


def _decibels(squared: np.ndarray) -> float:
    return float(-10 * np.log10(max(float(squared.mean()), _LEAST_ERROR)))
