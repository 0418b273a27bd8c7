"""How a photo was exposed, as EXIF says."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

from PIL import ExifTags

from blender_nep.capture.photos.photo_files import exif
from blender_nep.errors import CaptureError


class ExifExposure(NamedTuple):
    """What EXIF says of an exposure. None: nothing, or no positive number."""

    seconds: float | None
    f_number: float | None
    iso: float | None


def exif_exposure(path: Path) -> ExifExposure:
    """The exposure of a photo; nothing is known where its file cannot be read. Whether it is sound is seen elsewhere."""
    try:
        tags = exif(path)
    except CaptureError:
        tags = {}
    told = (ExifTags.Base.ExposureTime, ExifTags.Base.FNumber, ExifTags.Base.ISOSpeedRatings)
    return ExifExposure(*(_number(tags.get(tag)) for tag in told))


def _number(value: object) -> float | None:
    """A positive number, or None."""
    first = value[0] if isinstance(value, tuple) and value else value
    try:
        number = float(first)  # type: ignore[arg-type]
    except (TypeError, ValueError, ZeroDivisionError):
        return None
    return number if math.isfinite(number) and number > 0 else None
