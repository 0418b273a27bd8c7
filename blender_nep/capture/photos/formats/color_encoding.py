"""How the values of a photo's file become linear Rec.709 radiance: transfer functions and primaries."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from blender_nep.color import srgb_to_linear

Curve = Callable[[np.ndarray], np.ndarray]
"""Makes encoded values [...] in 0..1 linear, float32."""

Primaries = tuple[tuple[float, float], tuple[float, float], tuple[float, float]]
"""Chromaticities x, y of red, green and blue"""

_REC709: Primaries = ((0.64, 0.33), (0.30, 0.60), (0.15, 0.06))
_D65 = (0.3127, 0.3290)
_PRIMARIES: dict[int, Primaries] = {
    1: _REC709,
    2: _REC709,  # not specified
    5: ((0.64, 0.33), (0.29, 0.60), (0.15, 0.06)),  # BT.601, 625 lines
    6: ((0.63, 0.34), (0.31, 0.595), (0.155, 0.07)),  # BT.601, 525 lines
    9: ((0.708, 0.292), (0.17, 0.797), (0.131, 0.046)),  # BT.2020
    12: ((0.68, 0.32), (0.265, 0.69), (0.15, 0.06)),  # Display P3
}
"""ITU-T H.273, table 2; all have the white D65."""
_ADOBE_RGB: Primaries = ((0.64, 0.33), (0.21, 0.71), (0.15, 0.06))
_ADOBE_RGB_GAMMA = 563 / 256
_D50_XYZ = np.array([0.9642, 1.0, 0.8249])
_BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])

_SAME_CURVE, _SAME_MATRIX = 1e-3, 2e-3
"""Largest differences from sRGB's linear values, and from the unit matrix, that still count as sRGB. Profiles of sRGB are
rounded in several ways; all of them must give the same radiance as a photo without a profile."""

_LARGEST_COEFFICIENT = 10.0
"""A matrix with a larger coefficient comes from damaged primaries."""


@dataclass(frozen=True, eq=False)
class ColorEncoding:
    """The transfer functions and the primaries of a file's values."""

    curves: tuple[Curve, ...] = ()
    """One for all channels, or one each for red, green and blue. None: the values are linear."""
    to_rec709: np.ndarray | None = None
    """[3, 3] float32: from the file's linear values to Rec.709. None: they are Rec.709."""

    @property
    def is_linear(self) -> bool:
        """Whether the file's values are linear Rec.709 already."""
        return not self.curves and self.to_rec709 is None

    @cached_property
    def _tables_of_bytes(self) -> list[np.ndarray]:
        return self._tables(256)

    @cached_property
    def _tables_of_words(self) -> list[np.ndarray]:
        return self._tables(65536)

    def _tables(self, count: int) -> list[np.ndarray]:
        """The linear values of `count` equal steps from 0 to 1, by each curve."""
        steps = np.arange(count) / (count - 1.0)
        return [curve(steps) for curve in self.curves] or [steps.astype(np.float32)]

    def of_whole_numbers(self, color: np.ndarray) -> np.ndarray:
        """Linear Rec.709 values, float32, in 0..1, of values [..., 3] uint8 or uint16. They are those of `of_fractions`."""
        tables = self._tables_of_bytes if color.dtype == np.uint8 else self._tables_of_words
        if len(tables) == 1:
            return self._in_gamut(tables[0][color])
        return self._in_gamut(np.stack([table[color[..., i]] for i, table in enumerate(tables)], -1))

    def of_fractions(self, color: np.ndarray) -> np.ndarray:
        """Linear Rec.709 values, float32, of values [..., 3] in 0..1.

        A color outside Rec.709 is cut to 0..1, so that a file that cannot hold more than 1 gives no more than 1: this is
        how later steps know that its highlights may be clipped. A channel that is clipped in a file with wider primaries
        is at least 1 in Rec.709 before the cut, and so remains recognizable.
        """
        return self._in_gamut(self._curved(color))

    def of_radiance(self, color: np.ndarray) -> np.ndarray:
        """Linear Rec.709 values, float32, of any values [..., 3]; nothing is cut."""
        return self._turned(self._curved(color))

    def _curved(self, color: np.ndarray) -> np.ndarray:
        if not self.curves:
            return color.astype(np.float32)
        if len(self.curves) == 1:
            return self.curves[0](color)
        return np.stack([curve(color[..., i]) for i, curve in enumerate(self.curves)], -1)

    def _turned(self, linear: np.ndarray) -> np.ndarray:
        """Linear values in Rec.709. A pixel's result does not depend on how many pixels are handled at a time."""
        if self.to_rec709 is None:
            return linear
        red, green, blue = (linear[..., i] for i in range(3))
        with np.errstate(invalid="ignore"):  # infinity less infinity: such a pixel is left out later
            return np.stack([row[0] * red + row[1] * green + row[2] * blue for row in self.to_rec709], -1)

    def _in_gamut(self, linear: np.ndarray) -> np.ndarray:
        return np.clip(self._turned(linear), 0, 1)


LINEAR = ColorEncoding()
SRGB = ColorEncoding((srgb_to_linear,))


def power_curve(gamma: float) -> Curve:
    """The curve linear = value ^ gamma."""
    return partial(_power, gamma)


def _power(gamma: float, x: np.ndarray) -> np.ndarray:
    return (np.maximum(x, 0) ** gamma).astype(np.float32)


def _camera_curve(x: np.ndarray) -> np.ndarray:
    """Inverse of the camera curve of BT.709, BT.601 and BT.2020."""
    return np.where(x < 0.081, x / 4.5, ((np.maximum(x, 0.081) + 0.099) / 1.099) ** (1 / 0.45)).astype(np.float32)


def encoding_of(curves: tuple[Curve, ...], to_rec709: np.ndarray) -> ColorEncoding:
    """The encoding with these curves and this matrix. What is sRGB but for rounding becomes exactly sRGB.

    Raises ValueError where a curve does not lead from 0..1 into 0..1, or where the matrix is not finite.
    """
    steps = np.linspace(0, 1, 256)
    with np.errstate(all="ignore"):
        found = [curve(steps) for curve in curves]
    if not all(((values > -0.01) & (values < 1.01)).all() for values in found) or not np.isfinite(to_rec709).all():
        raise ValueError("not a transfer function")
    if all(np.abs(values - steps).max() < 1e-6 for values in found):
        curves = ()
    elif all(np.abs(values - srgb_to_linear(steps)).max() < _SAME_CURVE for values in found):
        curves = (srgb_to_linear,)
    elif all(np.array_equal(values, found[0]) for values in found):
        curves = curves[:1]
    same = np.abs(to_rec709 - np.eye(3)).max() < _SAME_MATRIX
    return ColorEncoding(curves, None if same else to_rec709.astype(np.float32))


def from_d50(colorants: np.ndarray) -> np.ndarray:
    """The matrix [3, 3] to Rec.709, from the columns of CIE XYZ [3, 3], relative to D50, of red, green and blue."""
    white = _xyz(_D65)
    to_d50 = _adaptation(white, _D50_XYZ)
    return np.linalg.solve(to_d50 @ _rgb_to_xyz(_REC709, _D65), colorants)


def from_primaries(primaries: Primaries, white: tuple[float, float]) -> np.ndarray:
    """The matrix [3, 3] to Rec.709 from primaries with this white (chromaticity x, y). White becomes white."""
    return from_d50(_adaptation(_xyz(white), _D50_XYZ) @ _rgb_to_xyz(primaries, white))


def _xyz(place: tuple[float, float]) -> np.ndarray:
    x, y = place
    return np.array([x / y, 1.0, (1 - x - y) / y])


def _rgb_to_xyz(primaries: Primaries, white: tuple[float, float]) -> np.ndarray:
    columns = np.stack([_xyz(place) for place in primaries], 1)
    return columns * np.linalg.solve(columns, _xyz(white))


def _adaptation(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Bradford's matrix from colors seen under the white XYZ `one` to those under `other`."""
    return np.linalg.solve(_BRADFORD, np.diag(_BRADFORD @ other / (_BRADFORD @ one)) @ _BRADFORD)


def adobe_rgb() -> ColorEncoding:
    """Adobe RGB (1998)."""
    return encoding_of((power_curve(_ADOBE_RGB_GAMMA),), from_primaries(_ADOBE_RGB, _D65))


def from_codes(primaries: int, transfer: int) -> ColorEncoding:
    """The encoding of the code points of ITU-T H.273, as HEIF's nclx box and PNG's cICP chunk give them.

    Raises ValueError for codes that are not known, such as the curves of HDR television.
    """
    curves: dict[int, tuple[Curve, ...]] = {code: (_camera_curve,) for code in (1, 6, 14, 15)}
    curves |= {2: (srgb_to_linear,), 4: (power_curve(2.2),), 5: (power_curve(2.8),), 8: (), 13: (srgb_to_linear,)}
    if primaries not in _PRIMARIES or transfer not in curves:
        hdr = " (HDR)" if transfer in (16, 18) else ""
        raise ValueError(f"its color primaries {primaries} with the transfer function {transfer}{hdr} are not supported")
    return encoding_of(curves[transfer], from_primaries(_PRIMARIES[primaries], _D65))


def from_chromaticities(places: Sequence[float]) -> ColorEncoding:
    """The encoding of linear values with the chromaticities x, y of red, green, blue and white.

    Damaged chromaticities count as none.
    """
    red, green, blue, white = ((float(places[i]), float(places[i + 1])) for i in range(0, 8, 2))
    try:
        with np.errstate(all="ignore"):
            matrix = from_primaries((red, green, blue), white)
    except (np.linalg.LinAlgError, ZeroDivisionError):  # primaries on a line, or with y = 0
        return LINEAR
    return encoding_of((), matrix) if np.abs(matrix).max() < _LARGEST_COEFFICIENT else LINEAR


def from_png_gamma(gamma: float | None, places: tuple[float, ...] | None) -> ColorEncoding:
    """The encoding that a PNG's gAMA chunk (the encoding exponent) and cHRM chunk (x, y of white, red, green, blue) give.

    None stands for a chunk that is not there. An exponent near 0.45455 means sRGB: writers of sRGB files write it for old
    readers, and libpng takes it so. Damaged chunks count as none.
    """
    curve: Curve = srgb_to_linear
    if gamma is not None and gamma > 0.05 and abs(gamma - 0.45455) > 0.005:
        curve = power_curve(1.0 if abs(gamma - 1) < 0.005 else 1 / gamma)
    matrix = np.eye(3)
    if places is not None and min(places[1::2]) > 0:
        white, red, green, blue = ((places[i], places[i + 1]) for i in range(0, 8, 2))
        with suppress(np.linalg.LinAlgError):  # primaries on a line
            matrix = from_primaries((red, green, blue), white)
    return encoding_of((curve,), matrix if np.abs(matrix).max() < _LARGEST_COEFFICIENT else np.eye(3))
