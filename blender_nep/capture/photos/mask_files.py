"""Reads mask files, in the meaning that they have."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path

import numpy as np

from blender_nep.capture.photos.formats.raster import Raster
from blender_nep.capture.photos.photo_files import open_image

_JPEG = (".jpg", ".jpeg")
_NOISE = 0.1
"""JPEG leaves values near black and near white around edges. Values so near to one of them count as that."""


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

    @classmethod
    def of(cls, path: Path, reading: MaskReading | None = None) -> MaskRaster:
        """Open the mask file at `path`. Raises CaptureError."""
        raster = open_image(path, "linear")
        mask = cls(raster, raster.least_alpha() < 1.0, noisy=path.suffix.lower() in _JPEG)
        if reading is None:
            return mask
        return replace(mask, white=reading.white, inverted=reading.meaning == MaskMeaning.BACKGROUND)

    @property
    def size(self) -> tuple[int, int]:
        """(H, W)"""
        return self.raster.size

    def rows(self, start: int = 0, end: int | None = None) -> np.ndarray:
        """Coverage [h, W] float32 in 0..1 of the rows start to end - 1."""
        color, alpha = self.raster.rows(start, end)
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
