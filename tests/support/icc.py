"""Writes small ICC profiles (ICC.1:2022) from published numbers."""

from __future__ import annotations

import struct

import numpy as np

DISPLAY_P3 = ((0.51512, 0.2412, -0.00105), (0.29198, 0.69225, 0.04189), (0.1571, 0.06657, 0.78407))
"""CIE XYZ, relative to D50, of red, green and blue, as in Apple's profile"""
ADOBE_RGB = ((0.60974, 0.31111, 0.01947), (0.20528, 0.62567, 0.06087), (0.14919, 0.06322, 0.74457))
"""As in Adobe's profile"""
SRGB = ((0.43607, 0.22249, 0.01392), (0.38515, 0.71687, 0.09708), (0.14307, 0.06061, 0.7141))
"""As in the profile sRGB IEC61966-2.1"""


def _fixed(numbers) -> bytes:
    return struct.pack(f">{len(numbers)}i", *(round(65536 * float(x)) for x in numbers))


def gamma_curve(gamma: float) -> bytes:
    """A curve tag with one number, rounded to 1 / 256."""
    return b"curv" + bytes(4) + struct.pack(">IH", 1, round(gamma * 256)) + bytes(2)


def table_curve(values: np.ndarray) -> bytes:
    """A curve tag with values in 0..1."""
    return b"curv" + bytes(4) + struct.pack(">I", len(values)) + np.round(values * 65535).astype(">u2").tobytes()


def parametric_curve(kind: int, *numbers: float) -> bytes:
    """A curve tag with a formula."""
    return b"para" + bytes(4) + struct.pack(">HH", kind, 0) + _fixed(numbers)


SRGB_CURVE = parametric_curve(3, 2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045)


def rgb_profile(colorants: tuple, *curves: bytes) -> bytes:
    """A profile with primaries, and one curve for all channels or three."""
    tags = {f"{name}XYZ": b"XYZ " + bytes(4) + _fixed(place) for name, place in zip("rgb", colorants, strict=True)}
    tags |= {f"{name}TRC": curve for name, curve in zip("rgb", curves * (4 - len(curves)), strict=False)}
    return profile(b"RGB ", b"XYZ ", tags)


def profile(space: bytes, connection: bytes, tags: dict[str, bytes], kind: bytes = b"mntr") -> bytes:
    """A profile for colors of `space`."""
    tags = {"wtpt": b"XYZ " + bytes(4) + _fixed((0.9642, 1.0, 0.8249))} | tags
    table, content, start = struct.pack(">I", len(tags)), b"", 132 + 12 * len(tags)
    for name, data in tags.items():
        table += struct.pack(">4sII", name.encode(), start + len(content), len(data))
        content += data + bytes(-len(data) % 4)
    head = struct.pack(">I4sI", start + len(content), b"none", 0x02400000) + kind + space + connection
    head += struct.pack(">6H", 2026, 1, 1, 0, 0, 0) + b"acsp" + bytes(28) + _fixed((0.9642, 1.0, 0.8249))
    return head + bytes(128 - len(head)) + table + content


def ink_profile() -> bytes:
    """A CMYK profile by tables, in CIE Lab: the lightness falls with black ink alone; the other inks only tint."""
    ends = [0, 255]
    grid = []
    for cyan in ends:
        for magenta in ends:
            for yellow in ends:
                for black in ends:
                    grid += [255 - black, 128 + (magenta - cyan) // 8, 128 + (yellow - cyan) // 8]
    line = bytes(range(256))
    unit = _fixed((1, 0, 0, 0, 1, 0, 0, 0, 1))
    tables = b"mft1" + bytes(4) + bytes([4, 3, 2, 0]) + unit + line * 4 + bytes(grid) + line * 3
    return profile(b"CMYK", b"Lab ", {"A2B0": tables}, kind=b"prtr")
