"""What photo files tell of the camera: whose it is, and how the photo was exposed."""

from __future__ import annotations

import numpy as np
import torch
from PIL import ExifTags

from blender_nep.capture.capture import Capture, View
from blender_nep.capture.exposure import LEAST_SPREAD, Comparison, Exposures
from blender_nep.capture.photos.exif_exposure import exif_exposure
from blender_nep.capture.photos.photo_files import exif, is_linear
from blender_nep.errors import CaptureError

_ASKED = 5
"""So many photos, spread over all, are asked for the camera."""
_OF_CAMERAS, _WITH_LOSSES = 1.0, 0.5
"""Strengths that are likely for photos that name their camera, and for other photos in a format with losses"""
_LOSSY = (".jpg", ".jpeg", ".webp", ".heic", ".heif", ".hif")
_MOST_DENIED = 0.12
"""Told exposures count if their logarithms differ from what the surroundings tell by less than this standard deviation.
The surroundings err by 0.04 to 0.07 (docs/lab/exposure.md)."""
_LEAST_BALANCE = 0.05
"""Standard deviation of the logarithms of the white balance from which on it counts. Only the surroundings tell it; where
it is constant, they make it seem to differ by less than this."""


def expected_response(capture: Capture) -> float | None:
    """The strength of the camera's response curve that the files make likely (`ResponseCurve`). None: values are linear.

    Cameras write their maker and model into the photos that they develop, and their curves are about 1. Photos in a format
    with losses but without these names come from anywhere: most were taken by a camera, and some program has removed its
    names. Lossless formats mostly come from renderers and from people who develop by hand, for which sRGB alone is expected.
    """
    if any(_holds_light(capture, view) for view in capture.views):  # also where others are developed: one curve fits all
        return None
    asked = capture.views[:: max(1, len(capture.views) // _ASKED)]
    if all(_names_camera(view) for view in asked):
        return _OF_CAMERAS
    return _WITH_LOSSES if all(view.image_path.suffix.lower() in _LOSSY for view in asked) else 0.0


def _holds_light(capture: Capture, view: View) -> bool:
    return capture.color_space == "linear" or is_linear(view.image_path)


def _names_camera(view: View) -> bool:
    try:
        tags = exif(view.image_path)
    except CaptureError:  # whether the pixels are sound is seen elsewhere
        return False
    return all(str(tags.get(tag) or "").strip("\0 ") for tag in (ExifTags.Base.Make, ExifTags.Base.Model))


def told_gains(capture: Capture) -> np.ndarray | None:
    """How much brighter [views] each photo was taken than the average, from time x ISO / f-number^2. None: not all tell.

    The geometric mean is 1. Apertures in EXIF are rounded to a third of a stop, exposure times to some percent.
    """
    told = []
    for view in capture.views:
        exposure = _exposure(view)
        if exposure is None:  # the others need not be asked
            return None
        told.append(exposure)
    log = np.log(np.array(told, np.float64))
    return np.exp(log - log.mean())


def _exposure(view: View) -> float | None:
    """Exposure time x ISO / f-number^2 of a photo. None: its file does not tell all three."""
    seconds, f_number, iso = exif_exposure(view.image_path)
    if seconds is None or f_number is None or iso is None:
        return None
    return seconds * iso / f_number**2


def told_exposures(told: np.ndarray | None, compared: Comparison | None, device: torch.device | str) -> Exposures | None:
    """The exposures that the files tell, with the white balance and the vignetting that the photos' surroundings tell.

    told [views] is that of `told_gains`. None: it is not told, it is the same for all photos, or the surroundings deny it.
    They do so where a flash was used, or where photos of several days were exposed for each day's light.
    """
    if told is None or np.log(told).std() < LEAST_SPREAD:
        return None
    log, vignetting = np.log(told)[:, None].repeat(3, 1), None
    if compared is not None:
        bright = compared.log.mean(1, keepdims=True)
        if (bright[:, 0] - np.log(told)).std() > _MOST_DENIED:
            return None
        balance = compared.log - bright
        if np.sqrt((balance**2).mean()) > _LEAST_BALANCE:
            log = log + balance
        vignetting = compared.exposures(device).vignetting
    gain = torch.from_numpy(np.exp(log).astype(np.float32)).to(device)
    return Exposures(gain, None, vignetting)
