"""Asks the photos whether cameras are right: common features of neighboring photos must lie on common rays.

It is asked only where the cameras alone do not tell how a file means them (conventions.py). So it may take some seconds.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from pathlib import Path

import numpy as np

from blender_nep.capture.cameras.camera import Camera
from blender_nep.capture.photos.photo_files import open_image
from blender_nep.color import linear_to_srgb
from blender_nep.errors import CaptureError

_LONGEST = 800
"""Pixels of the longer side of the copies in which features are sought"""
_PAIRS = 8
_FEATURES = 1500
_MOST_OFF = 3.0
"""Pixels of a copy that a feature may lie off the line on which the other photo's camera expects it"""
_RATIO = 0.8
"""A match counts if the next best one differs clearly more (Lowe's ratio)."""
_FEWEST = 30
"""With fewer common features in all pairs, the photos do not tell."""


class PhotoAgreement:
    """Common features of some pairs of photos, found at the first question."""

    def __init__(self, photos: Sequence[Path]) -> None:
        """The photos, in the order in which they were taken: neighbors are compared."""
        self._photos = photos

    def __call__(self, cameras: Sequence[Camera]) -> float | None:
        """The share of the common features that agree with the cameras of all photos; None where too few are found.

        A feature agrees if the two rays pass each other within `_MOST_OFF` pixels, in front of both cameras.
        """
        total = sum(len(one) for _, _, one, _ in self._matches)
        if total < _FEWEST:
            return None
        return sum(_agreeing(cameras[i], cameras[j], one, other) for i, j, one, other in self._matches) / total

    @cached_property
    def _matches(self) -> list[tuple[int, int, np.ndarray, np.ndarray]]:
        """(i, j, places [m, 2] in photo i, in photo j): in parts of the width and the height"""
        from skimage.feature import match_descriptors  # it takes a second, and is needed rarely

        count = len(self._photos)
        starts = sorted({round(k * (count - 2) / max(1, _PAIRS - 1)) for k in range(min(_PAIRS, count - 1))})
        features: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        out = []
        for i in starts:
            for n in (i, i + 1):
                if n not in features:
                    features[n] = _features(self._photos[n])
            (one, describe_one), (other, describe_other) = features[i], features[i + 1]
            if len(one) and len(other):
                pairs = match_descriptors(describe_one, describe_other, cross_check=True, max_ratio=_RATIO)
                out.append((i, i + 1, one[pairs[:, 0]], other[pairs[:, 1]]))
        return out


def _features(photo: Path) -> tuple[np.ndarray, np.ndarray]:
    """Places [m, 2], in parts of the width and the height, and descriptors [m, 256] bool of a photo's features."""
    from skimage.feature import ORB

    orb = ORB(n_keypoints=_FEATURES, fast_threshold=0.03)
    try:
        gray = _gray_copy(photo)
        orb.detect_and_extract(gray)
    except (CaptureError, RuntimeError):  # a photo that cannot be read, or that shows no features
        return np.zeros((0, 2)), np.zeros((0, 256), bool)
    places = (np.asarray(orb.keypoints)[:, ::-1] + 0.5) / gray.shape[::-1]
    return places, np.asarray(orb.descriptors)


def _gray_copy(photo: Path) -> np.ndarray:
    """The photo reduced to `_LONGEST`, gray values [h, w] in 0..1 as a screen shows them. Raises CaptureError."""
    raster = open_image(photo, "srgb")
    height, width = raster.size
    step = max(1, -(-max(height, width) // _LONGEST))
    rows = []
    for start in range(0, height - step + 1, step):
        strip = np.nan_to_num(raster.rows(start, start + step)[0]).mean(-1)[:, : width // step * step]
        rows.append(strip.reshape(step, -1, step).mean((0, 2)))
    gray = np.clip(np.stack(rows), 0, None)
    bright = np.quantile(gray, 0.99)
    return linear_to_srgb(np.clip(gray / max(float(bright), 1e-9), 0, 1))


def _agreeing(one: Camera, other: Camera, places_one: np.ndarray, places_other: np.ndarray) -> int:
    """How many of the common features agree with the two cameras."""
    baseline = other.position - one.position
    a = one.directions(places_one[:, 0] * one.width, places_one[:, 1] * one.height)
    b = other.directions(places_other[:, 0] * other.width, places_other[:, 1] * other.height)
    normal = np.cross(baseline, a)
    length = np.linalg.norm(normal, axis=1)
    off = np.abs((normal * b).sum(1)) / np.maximum(length, 1e-300)
    pixels = max(one.width, one.height) / min(_LONGEST, max(one.width, one.height))
    near = off < _MOST_OFF * pixels / min(other.fl_x, other.fl_y)
    # The depths s, t of the nearest points of both rays: s a - t b = baseline, by least squares.
    cosine = (a * b).sum(1)
    along_a, along_b = a @ baseline, b @ baseline
    divisor = np.maximum(1 - cosine**2, 1e-12)
    ahead = ((along_a - cosine * along_b) / divisor > 0) & ((cosine * along_a - along_b) / divisor > 0)
    turned = length > 1e-6 * np.linalg.norm(baseline)
    return int((near & ahead & turned).sum())
