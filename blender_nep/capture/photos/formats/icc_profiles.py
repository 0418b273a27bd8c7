"""Reads ICC profiles of photos (ICC.1:2022): primaries and curves. Profiles with tables need Pillow's ImageCms."""

from __future__ import annotations

import struct
from functools import partial

import numpy as np

from blender_nep.capture.photos.formats.color_encoding import SRGB, ColorEncoding, Curve, encoding_of, from_d50, power_curve

_PARAMETERS = {0: 1, 1: 3, 2: 4, 3: 5, 4: 7}
"""{function type of a parametric curve: number of its parameters}"""


class TableProfile(ValueError):
    """The profile is not one of primaries and curves."""


def from_icc(profile: bytes) -> ColorEncoding:
    """The encoding that an ICC profile describes. A damaged profile counts as none, so that the photo is sRGB.

    Raises TableProfile for a profile without primaries, such as a printer's.
    """
    try:
        tags, space = _tags(profile), profile[16:20]
        if space == b"GRAY" and "kTRC" in tags:
            return encoding_of((_curve(tags["kTRC"]),), np.eye(3))
        needed = [*(f"{channel}XYZ" for channel in "rgb"), *(f"{channel}TRC" for channel in "rgb")]
        if all(name in tags for name in needed):
            colorants = np.stack([_fixed(tags[f"{channel}XYZ"][8:20]) for channel in "rgb"], 1)
            return encoding_of(tuple(_curve(tags[f"{channel}TRC"]) for channel in "rgb"), from_d50(colorants))
    except (struct.error, ValueError, IndexError):
        return SRGB
    raise TableProfile("its color profile has tables instead of primaries: convert the photo to sRGB")


def _tags(profile: bytes) -> dict[str, bytes]:
    if profile[36:40] != b"acsp":
        raise ValueError("not an ICC profile")
    (count,) = struct.unpack_from(">I", profile, 128)
    tags = {}
    for number in range(min(count, 200)):
        name, offset, size = struct.unpack_from(">4sII", profile, 132 + 12 * number)
        tags[name.decode("latin-1")] = profile[offset : offset + size]
    return tags


def _fixed(data: bytes) -> np.ndarray:
    """Numbers in ICC's fixed-point form s15Fixed16."""
    return np.frombuffer(data, ">i4") / 65536.0


def _curve(tag: bytes) -> Curve:
    if tag[:4] == b"curv":
        (count,) = struct.unpack_from(">I", tag, 8)
        if count == 0:
            return power_curve(1.0)
        values = np.frombuffer(tag, ">u2", count, 12)
        return power_curve(values[0] / 256) if count == 1 else partial(_interpolated, values / 65535.0)
    if tag[:4] != b"para":
        raise ValueError("unknown kind of curve")
    (kind,) = struct.unpack_from(">H", tag, 8)
    if kind not in _PARAMETERS:
        raise ValueError("unknown kind of parametric curve")
    numbers = _fixed(tag[12 : 12 + 4 * _PARAMETERS[kind]])
    if len(numbers) != _PARAMETERS[kind]:
        raise ValueError("truncated parametric curve")
    g, a, b, c, d, e, f = (float(x) for x in np.pad(numbers, (0, 7 - len(numbers))))
    if kind == 0:
        return power_curve(g)
    if kind in (1, 2):  # Y = (a X + b)^g + c from X = -b / a on, and c below
        if a == 0:
            raise ValueError("a parametric curve without slope")
        c, d, e, f = 0.0, -b / a, c, c
    return partial(_parametric, (g, a, b, c, d, e, f))


def _interpolated(values: np.ndarray, x: np.ndarray) -> np.ndarray:
    return np.interp(x, np.linspace(0, 1, len(values)), values).astype(np.float32)


def _parametric(numbers: tuple[float, ...], x: np.ndarray) -> np.ndarray:
    """Y = (a X + b)^g + e from X = d on, and c X + f below."""
    g, a, b, c, d, e, f = numbers
    return np.where(x >= d, np.maximum(a * x + b, 0) ** g + e, c * x + f).astype(np.float32)
