"""Writes a small camera raw file (DNG 1.4) whose sensor sees the primaries of Rec.709."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import tifffile

WHITE = 16383
_REC709_TO_XYZ = [[0.4123908, 0.3575843, 0.1804808], [0.2126390, 0.7151687, 0.0721923], [0.0193308, 0.1191948, 0.9505322]]


def write_dng(path: Path, sensor: np.ndarray, neutral: tuple[float, float, float] = (1.0, 1.0, 1.0), **tags) -> None:
    """Write the sensor's values [H, W, 3] below `WHITE` behind a Bayer pattern.

    neutral: the sensor's values of white. tags: orientation, or `film` (the focal length for film of 35 mm).
    """
    mosaic = np.zeros(sensor.shape[:2], np.uint16)
    for y, x, channel in ((0, 0, 0), (0, 1, 1), (1, 0, 1), (1, 1, 2)):
        mosaic[y::2, x::2] = sensor[y::2, x::2, channel]
    to_camera = np.linalg.inv(_REC709_TO_XYZ).ravel()
    extra = [
        (271, 2, 0, "Maker", True),
        (272, 2, 0, "Model", True),
        (274, 3, 1, tags.get("orientation", 1), True),
        (33421, 3, 2, (2, 2), True),  # size of the Bayer pattern
        (33422, 1, 4, bytes([0, 1, 1, 2]), True),
        (50706, 1, 4, bytes([1, 4, 0, 0]), True),  # version of DNG
        (50708, 2, 0, "Maker Model", True),
        (50714, 5, 1, (0, 1), True),  # black
        (50717, 3, 1, WHITE, True),
        (50721, 10, 9, _fractions(to_camera), True),
        (50728, 5, 3, _fractions(neutral), True),
        (50778, 3, 1, 21, True),  # the light D65
    ]
    if "film" in tags:
        extra.append((41989, 3, 1, tags["film"], True))
    tifffile.imwrite(path, mosaic, photometric="cfa", extratags=extra, metadata=None)


def _fractions(values) -> list[int]:
    return [part for value in values for part in (round(10000 * float(value)), 10000)]
