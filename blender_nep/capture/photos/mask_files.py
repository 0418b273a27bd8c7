"""Reads mask files, in the meaning that they have."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from enum import StrEnum
from pathlib import Path

import numpy as np
from scipy import ndimage

from blender_nep.capture.photos.formats.raster import Raster
from blender_nep.capture.photos.photo_files import open_image

_JPEG = (".jpg", ".jpeg")
_NOISE = 0.1
"""JPEG leaves values near black and near white around edges. Values so near to one of them count as that."""
_LARGEST_HOLE = 0.002
"""Of a picture before one color: what has that color and is a smaller part of the photo is a dark spot of the object."""


class MaskMeaning(StrEnum):
    """What white in the masks of a capture means."""

    OBJECT = "object"
    """White is the object."""
    BACKGROUND = "background"
    """White is everything but the object."""
    USABLE = "usable"
    """White may be used, black may not. The masks do not say where the object is."""
    NOTHING = "nothing"
    """The masks are passed over."""


@dataclass(frozen=True)
class MaskReading:
    """How the mask files of a capture are read."""

    meaning: MaskMeaning = MaskMeaning.OBJECT
    white: float = 1.0
    """The value that counts as white, as a fraction of the largest value that the files can store."""
    color: MaskColor | None = None
    """The color that decides in colored masks; None: the brightness decides"""
    turned: frozenset[Path] = field(default_factory=frozenset)
    """The masks whose black is what white is in the others"""


@dataclass(frozen=True)
class MaskColor:
    """A color that tells the object in colored masks."""

    value: tuple[float, float, float]
    """As the files store it, each 0..1"""
    tolerance: float
    """How far a channel may be from it"""
    is_object: bool
    """Whether this is the color of the object, or of all that is not the object"""

    def white(self, color: np.ndarray) -> np.ndarray:
        """Where the colors [h, w, 3] show the object, [h, w] bool."""
        equal = np.abs(color - np.array(self.value, np.float32)).max(-1) <= self.tolerance
        return equal if self.is_object else ~equal


@dataclass
class MaskRaster:
    """A mask file. The coverage is its alpha, if some of that is below 1; else its first channel, without sRGB decoding."""

    raster: Raster
    from_alpha: bool
    white: float = 1.0
    """As in `MaskReading`"""
    inverted: bool = False
    noisy: bool = False
    """The file is a JPEG."""
    shown: np.ndarray | None = None
    """[H, W] bool: where a colored mask shows the object"""
    scaled_to: tuple[int, int] | None = None
    """(H, W) of the photo, if the mask is smaller or larger"""

    @classmethod
    def of(cls, path: Path, reading: MaskReading | None = None) -> MaskRaster:
        """Open the mask file at `path`. Raises CaptureError."""
        raster = open_image(path, "linear")
        mask = cls(raster, raster.least_alpha() < 1.0, noisy=path.suffix.lower() in _JPEG)
        if reading is None:
            return mask
        inverted = (reading.meaning == MaskMeaning.BACKGROUND) != (path in reading.turned)
        shown = None if reading.color is None or mask.from_alpha else _shown(raster, reading.color)
        return replace(mask, white=reading.white, inverted=inverted, shown=shown)

    def fitted(self, height: int, width: int) -> MaskRaster:
        """The mask for a photo of that size; itself where the aspect is another one."""
        own = self.raster.size
        alike = same_aspect((own[1], own[0]), (width, height))
        return replace(self, scaled_to=(height, width)) if alike and own != (height, width) else self

    @property
    def size(self) -> tuple[int, int]:
        """(H, W)"""
        return self.scaled_to or self.raster.size

    def rows(self, start: int = 0, end: int | None = None) -> np.ndarray:
        """Coverage [h, W] float32 in 0..1 of the rows start to end - 1."""
        if self.scaled_to is None:
            return self._rows(start, end)
        (height, width), (own_height, own_width) = self.scaled_to, self.raster.size
        rows = (np.arange(*slice(start, end).indices(height)) + 0.5) * own_height / height
        columns = (np.arange(width) + 0.5) * own_width / width
        first = int(rows[0]) if len(rows) else 0
        own = self._rows(first, int(rows[-1]) + 1 if len(rows) else 0)
        return own[rows.astype(int) - first][:, columns.astype(int)]

    def look(self, step: int) -> tuple[np.ndarray, np.ndarray | None]:
        """Coverage [h, w] and stored colors [h, w, 3], 0..1, of every `step`-th pixel; no colors if alpha decides.

        The mask has not been read by a `MaskReading` with a color.
        """
        coverage, colors = [], []
        for row in range(step // 2, self.raster.size[0], step):
            color, alpha = self.raster.rows(row, row + 1)
            coverage.append(self._coverage(color, alpha)[:, step // 2 :: step])
            colors.append(color[:, step // 2 :: step])
        return np.concatenate(coverage), None if self.from_alpha else np.concatenate(colors)

    def _rows(self, start: int, end: int | None) -> np.ndarray:
        """`rows` of the file's own size."""
        if self.shown is not None:
            part = self.shown[start:end].astype(np.float32)
            return 1 - part if self.inverted else part
        return self._coverage(*self.raster.rows(start, end))

    def _coverage(self, color: np.ndarray, alpha: np.ndarray | None) -> np.ndarray:
        """Coverage [h, W] by the colors [h, W, 3] and alpha [h, W] of some rows."""
        coverage = alpha if self.from_alpha and alpha is not None else color[..., 0]
        coverage = np.nan_to_num(np.clip(coverage, 0.0, self.white)).astype(np.float32)
        if self.white != 1.0:
            coverage /= np.float32(self.white)
        if self.noisy:
            coverage = np.clip((coverage - _NOISE) / (1 - 2 * _NOISE), 0.0, 1.0).astype(np.float32)
        return 1 - coverage if self.inverted else coverage

    def coverage(self, step: int = 1) -> np.ndarray:
        """Coverage [h, w] float32 in 0..1 of every `step`-th pixel in both directions, from pixel step // 2 on.

        Only the rows of these pixels are read. step: at most the shorter side.
        """
        if step == 1:
            return self.rows()
        kept = range(step // 2, self.size[0], step)
        return np.concatenate([self.rows(row, row + 1)[:, step // 2 :: step] for row in kept])


def same_aspect(one: tuple[int, int], other: tuple[int, int]) -> bool:
    """Whether two sizes (width, height) have the same aspect, within 1 %."""
    return abs(one[0] * other[1] / (one[1] * other[0]) - 1) <= 0.01


def _shown(raster: Raster, color: MaskColor) -> np.ndarray:
    """Where a colored mask shows the object, [H, W] bool."""
    strips = range(0, raster.size[0], 256)
    shown = np.concatenate([color.white(raster.rows(start, start + 256)[0]) for start in strips])
    if color.is_object:
        return shown
    holes, count = ndimage.label(~shown)
    small = np.bincount(holes.ravel(), minlength=count + 1) < _LARGEST_HOLE * shown.size
    small[0] = False
    return shown | small[holes]
