"""Warns of lenses that hardly any camera has. Their numbers are used all the same: nobody knows better ones."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import torch

from blender_nep.capture.cameras.camera import Camera
from blender_nep.capture.cameras.lens import Lenses
from blender_nep.messages import Message

_MOST_DIFFERENCE = 0.04
"""Sensors have square pixels. Calibrations from few photos are off by a percent or two"""
_MOST_OFF_CENTER = 0.1
"""Largest distance of the principal point from the middle, relative to the side. Cropped photos have more."""
_MOST_SKEW = 0.02
_MOST_TANGENTIAL = 0.01
"""p1 and p2. Lenses that are mounted well have a thousandth."""
_MOST_TERM = 1.5
"""A term that changes the radius in the corners by more than this factor balances another one: the fit went astray."""
_LENGTHENED, _SHORTENED = 0.6, 2.5
"""How far the ratio of the radius without distortion to the radius with it may go in the corners"""
_NARROWEST, _WIDEST = 2.0, 140.0
"""Degrees, along the longer side, of a lens that is no fisheye"""
_MOST_HIDDEN = 0.01
"""Share of the pixels in which the lens shows nothing, because its distortion folds"""
_GRID = 24


def lens_warnings(names: Sequence[str], cameras: Sequence[Camera]) -> list[Message]:
    """Warnings about what looks wrong in the lenses of the photos `names`."""
    groups: dict[tuple, list[int]] = {}
    for i, camera in enumerate(cameras):
        key = (camera.width, camera.height, camera.fl_x, camera.fl_y, camera.cx, camera.cy, camera.lens)
        groups.setdefault(key, []).append(i)
    lenses = [(cameras[members[0]], [names[i] for i in members]) for members in groups.values()]

    def beyond(of: Callable[[Camera], float], most: float) -> tuple[list[str], Camera]:
        """The names of all photos that have more than `most`, and the camera with the largest value."""
        found = [(of(camera), n) for n, (camera, _) in enumerate(lenses)]
        bad = [name for value, n in found if not value <= most for name in lenses[n][1]]
        return bad, lenses[max(found)[1]][0]

    out: list[Message] = []
    bad, camera = beyond(_focal_difference, _MOST_DIFFERENCE)
    if bad:
        values = {"count": len(bad), "percent": 100 * _focal_difference(camera), "names": bad}
        out.append(Message("capture.focal_lengths_differ", values))
    bad, camera = beyond(_off_center, _MOST_OFF_CENTER)
    if bad:
        across, down = 100 * camera.cx / camera.width, 100 * camera.cy / camera.height
        out.append(Message("capture.principal_point_off", {"count": len(bad), "across": across, "down": down, "names": bad}))
    bad, _ = beyond(_odd_distortion, 0)
    if bad:
        out.append(Message("capture.distortion_large", {"count": len(bad), "names": bad}))
    bad, camera = beyond(_odd_angle, 0)
    if bad:
        out.append(Message("capture.view_angle_odd", {"count": len(bad), "degrees": _angle(camera), "names": bad}))
    bad, camera = beyond(lambda camera: abs(camera.lens.skew), _MOST_SKEW)
    if bad:
        out.append(Message("capture.skew_large", {"count": len(bad), "percent": 100 * camera.lens.skew, "names": bad}))
    return out


def _focal_difference(camera: Camera) -> float:
    """By what part the larger focal length exceeds the smaller one."""
    return max(camera.fl_x, camera.fl_y) / min(camera.fl_x, camera.fl_y) - 1


def _off_center(camera: Camera) -> float:
    return max(abs(camera.cx / camera.width - 0.5), abs(camera.cy / camera.height - 0.5))


def _angle(camera: Camera) -> float:
    """The angle of view along the longer side without distortion, in degrees."""
    half = max(camera.width / camera.fl_x, camera.height / camera.fl_y) / 2
    return float(np.degrees(2 * np.arctan(half)))


def _odd_angle(camera: Camera) -> float:
    return float(not camera.lens.fisheye and not _NARROWEST <= _angle(camera) <= _WIDEST)


def _odd_distortion(camera: Camera) -> float:
    """1 if the distortion looks wrong, else 0."""
    lens = camera.lens
    if lens.is_pinhole:
        return 0.0
    if max(abs(lens.p1), abs(lens.p2)) > _MOST_TANGENTIAL:
        return 1.0
    x, y = np.meshgrid(np.linspace(0, camera.width, _GRID), np.linspace(0, camera.height, _GRID))
    u, v = (x.ravel() - camera.cx) / camera.fl_x, (y.ravel() - camera.cy) / camera.fl_y
    direction, _, shown = (part.numpy() for part in Lenses.of([lens]).directions(torch.from_numpy(u), torch.from_numpy(v)))
    if (~shown).mean() > _MOST_HIDDEN:
        return 1.0
    across = np.hypot(direction[:, 0], direction[:, 1])
    straight = np.arctan2(across, direction[:, 2]) if lens.fisheye else across / np.maximum(direction[:, 2], 1e-9)
    radius = np.hypot(u, v)
    far = int(np.argmax(np.where(shown, radius, 0)))
    ratio, r = straight[far] / radius[far], float(straight[far])
    terms = max(abs(k) * r ** (2 * n) for n, k in enumerate((lens.k1, lens.k2, lens.k3, lens.k4), 1))
    return float(not _LENGTHENED <= ratio <= _SHORTENED or terms > _MOST_TERM)
