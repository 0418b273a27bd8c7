"""What photo files tell of the camera's tone curve."""

from __future__ import annotations

from PIL import ExifTags

from blender_nep.capture.capture import Capture, View
from blender_nep.capture.photos.photo_files import exif, is_linear
from blender_nep.errors import CaptureError

_ASKED = 5
"""So many photos, spread over all, are asked for the camera."""
_OF_CAMERAS, _WITH_LOSSES = 1.0, 0.5
"""Strengths that are likely for photos that name their camera, and for other photos in a format with losses"""
_LOSSY = (".jpg", ".jpeg", ".webp", ".heic", ".heif", ".hif")


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
