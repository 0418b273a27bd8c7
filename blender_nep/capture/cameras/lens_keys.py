"""The keys of transforms.json that tell focal length, size and lens, as instant-ngp, nerfstudio and we write them.

A value in a frame counts before the one at the top of the file. What no `Lens` can be is refused by the name of its key.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from blender_nep.capture.cameras.camera import Camera
from blender_nep.capture.cameras.lens import Lens
from blender_nep.errors import CaptureError

_OPENCV = ("PINHOLE", "SIMPLE_PINHOLE", "OPENCV", "PERSPECTIVE", "SIMPLE_RADIAL", "RADIAL", "FULL_OPENCV")
_FISHEYE = ("OPENCV_FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE")
_TERMS = ("k1", "k2", "k3", "k4", "p1", "p2")
_LIST = "distortion_params"
"""nerfstudio's list of the terms, in the order of `_TERMS`"""
_OTHER_TERMS = ("k5", "k6", "sx1", "sy1", "s1", "s2", "s3", "s4", "omega", "p3", "p4")
_OTHER_PROJECTIONS = ("equirectangular", "latlong", "ftheta_p0", "is_orthographic")
_CUT = "Cut the panoramas into ordinary photos, and find the cameras of these."
_UNDISTORT = "Use PINHOLE, OPENCV or OPENCV_FISHEYE, or undistort the photos."
_MOST_SHARE = 20.0
"""Focal lengths of less than this are parts of the photo's width where the principal point is, too."""
_SAME_ANGLE = 0.05
"""Focal lengths by two angles that differ by more than this contradict each other."""


@dataclass(frozen=True)
class LensKeys:
    """The keys of one frame: `frame`, then `meta`, the top of the file. `name` is its photo, for messages."""

    meta: Mapping[str, Any]
    frame: Mapping[str, Any]
    name: str

    def value(self, key: str) -> Any:
        """The value of a key, or None."""
        return self.frame.get(key, self.meta.get(key))

    def number(self, key: str) -> float | None:
        """The number of a key, or None where the key is missing. Raises CaptureError where it is no finite number."""
        value = self.value(key)
        return None if value is None else self._finite(value, key)

    def _finite(self, value: object, key: str) -> float:
        try:
            number = math.nan if isinstance(value, bool) or not isinstance(value, int | float) else float(value)
        except OverflowError:  # a whole number of hundreds of digits
            number = math.nan
        if not math.isfinite(number):
            raise CaptureError(f"{self.name}: {key} is not a number")
        return number

    def camera_parts(self, size: Callable[[], tuple[int, int]], odd_angles: list[str]) -> dict[str, Any]:
        """The arguments of `Camera` but `camera_to_world`. `size` gives (width, height) of the photo, if the file does not.

        Where two angles of view contradict each other, so that pixels would be no squares, camera_angle_x counts, and the
        photo's name is added to `odd_angles`. Raises CaptureError.
        """
        width, height = self.number("w"), self.number("h")
        if not width or not height:
            found = size()
            width, height = width or found[0], height or found[1]
        fl_x, fl_y = self._focal_lengths(width, height, odd_angles)
        cx, cy = self.number("cx"), self.number("cy")
        if cx is not None and cy is not None and 0 < max(cx, cy) <= 1 and 0 < max(fl_x, fl_y) < _MOST_SHARE:
            raise CaptureError(
                f"{self.name}: focal length and principal point are parts of the size, not pixels",
                "Multiply fl_x and cx by the width, fl_y and cy by the height.",
            )
        if min(fl_x, fl_y) <= 0 or min(round(width), round(height)) < 1:
            raise CaptureError(f"{self.name}: focal length and size must be positive")
        return {
            "width": round(width),
            "height": round(height),
            "fl_x": fl_x,
            "fl_y": fl_y,
            "cx": width / 2 if cx is None else cx,
            "cy": height / 2 if cy is None else cy,
            "lens": self._lens(fl_x),
        }

    def _focal_lengths(self, width: float, height: float, odd_angles: list[str]) -> tuple[float, float]:
        given_x, given_y = self.number("fl_x"), self.number("fl_y")
        angle_x, angle_y = self._focal_by_angle("x", width), self._focal_by_angle("y", height)
        fl_x = angle_x if given_x is None else given_x
        fl_y = given_y or None
        if fl_y is None and given_x is None and angle_y is not None:
            fl_y = angle_y
            if fl_x is not None and abs(fl_y / fl_x - 1) > _SAME_ANGLE:
                odd_angles.append(self.name)
                fl_y = fl_x
        fl_x = fl_y if fl_x is None else fl_x
        if fl_x is None:
            raise CaptureError(
                f"{self.name} has no focal length",
                "Give fl_x in pixels, camera_angle_x in radians, or x_fov in degrees; or fl_y, camera_angle_y, y_fov.",
            )
        return fl_x, fl_x if fl_y is None else fl_y

    def _focal_by_angle(self, axis: str, side: float) -> float | None:
        """The focal length in pixels by the angle of view along an axis: `camera_angle_x` in radians, `x_fov` in degrees."""
        for key, straight, most in ((f"camera_angle_{axis}", math.pi, "pi"), (f"{axis}_fov", 180.0, "180 degrees")):
            angle = self.number(key)
            if angle is None:
                continue
            if not 0 < angle < straight:
                hint = f"It is in radians; {axis}_fov is in degrees." if "camera" in key else ""
                raise CaptureError(f"{self.name}: {key} {angle:.4g} is not an angle between 0 and {most}", hint)
            return 0.5 * side / math.tan(0.5 * math.pi * angle / straight)
        return None

    def _lens(self, fl_x: float) -> Lens:
        """The distortion. Raises CaptureError for lenses that `Lens` does not have."""
        for key in _OTHER_PROJECTIONS:
            if self.value(key) not in (None, False, 0):
                raise CaptureError(f"{self.name}: {key} photos are not supported", _UNDISTORT if "_" in key else _CUT)
        default = "OPENCV_FISHEYE" if self.value("is_fisheye") else "OPENCV"
        model = str(self.frame.get("camera_model") or self.meta.get("camera_model") or default).upper()
        if model not in _OPENCV + _FISHEYE:
            raise CaptureError(f"camera model {model} is not supported", _CUT if "RECT" in model else _UNDISTORT)
        refused = [key for key in _OTHER_TERMS if self.number(key)]
        k1, k2, k3, k4, p1, p2 = self._terms()
        if k4 and model not in _FISHEYE and (model == "FULL_OPENCV" or self.value("k5") is not None):
            refused.append("k4")  # there it belongs to the divisor of OpenCV's model
        if refused:
            raise CaptureError(f"{self.name}: the distortion {', '.join(refused)} is not supported", _UNDISTORT)
        if model in _FISHEYE and (p1 or p2):
            raise CaptureError(f"{self.name}: a fisheye lens has no p1 and p2", "Take them out, or correct camera_model.")
        skew = (self.number("skew") or 0.0) / fl_x if fl_x > 0 else 0.0
        return Lens(k1, k2, k3, k4, p1, p2, fisheye=model in _FISHEYE, skew=skew)

    def _terms(self) -> list[float]:
        """The terms in the order of `_TERMS`. Raises CaptureError where the list and the keys contradict each other."""
        where = next((part for part in (self.frame, self.meta) if part.get(_LIST) is not None), {})
        listed = where.get(_LIST)
        if listed is None or (where is self.meta and any(key in self.frame for key in _TERMS)):
            return [self.number(key) or 0.0 for key in _TERMS]
        if not isinstance(listed, list) or len(listed) != len(_TERMS):
            raise CaptureError(
                f"{self.name}: {_LIST} is not a list of {len(_TERMS)} numbers",
                f"nerfstudio's list has {', '.join(_TERMS)}.",
            )
        terms = [self._finite(value, _LIST) for value in listed]
        keys = [self._finite(where[key], key) if where.get(key) is not None else None for key in _TERMS]
        odd = [key for key, one, term in zip(_TERMS, keys, terms, strict=True) if one not in (None, term)]
        if odd and any(keys):
            raise CaptureError(
                f"{self.name}: {_LIST} and {', '.join(odd)} contradict each other", "Leave only the one that counts."
            )
        return terms


def intrinsics_of(camera: Camera) -> dict[str, float | str]:
    """The keys of transforms.json for the camera's size, intrinsics [pixels] and lens, without terms that are 0."""
    terms = {name: getattr(camera.lens, name) for name in _TERMS} | {"skew": camera.lens.skew * camera.fl_x}
    return {
        "camera_model": "OPENCV_FISHEYE" if camera.lens.fisheye else "OPENCV",
        "w": camera.width,
        "h": camera.height,
        "fl_x": camera.fl_x,
        "fl_y": camera.fl_y,
        "cx": camera.cx,
        "cy": camera.cy,
        **{name: value for name, value in terms.items() if value},
    }
