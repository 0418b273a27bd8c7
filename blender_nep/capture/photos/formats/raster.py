"""An image as its file stores it, whose rows become linear radiance."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from blender_nep.capture.photos.formats.color_encoding import ColorEncoding

MOST_VALUES = 1 << 30
"""Values of an image: a file that says it has more is taken as damaged, because it would not fit into memory. A photo of 250
megapixels has 750 million."""


def check_values(width: int, height: int, channels: int) -> None:
    """Raises ValueError if an image of this size has more than `MOST_VALUES`."""
    if width * height * channels > MOST_VALUES:
        raise ValueError(f"its size is {width} x {height} x {channels}")


@dataclass
class Raster:
    """An image as its file stores it. `rows` makes a few rows linear at a time.

    The whole image as float32 radiance would be four times as large as an 8-bit file in memory.
    """

    stored: np.ndarray
    """[H, W, C] uint8, uint16, float16 or float32; C = 1 (gray), 2 (gray, alpha), 3 (RGB) or 4 (RGBA)"""
    encoding: ColorEncoding
    """How the stored values become linear."""
    associated: bool = False
    """The stored colors are multiplied by alpha, as in OpenEXR; `rows` divides them by alpha."""

    @property
    def size(self) -> tuple[int, int]:
        """(H, W)"""
        return self.stored.shape[0], self.stored.shape[1]

    @property
    def is_float(self) -> bool:
        """Whether the image may hold NaN, infinity, negative values and values above 1."""
        return self.stored.dtype.kind == "f"

    @property
    def _top(self) -> np.float32:
        return np.float32(1 if self.is_float else np.iinfo(self.stored.dtype).max)

    def least_alpha(self) -> float:
        """Smallest alpha in the image, 0..1; 1 where the file has no alpha."""
        if self.stored.shape[-1] in (1, 3):
            return 1.0
        alpha = self.stored[..., -1]
        if self.is_float:
            alpha = np.clip(np.nan_to_num(alpha), 0.0, 1.0)
        return float(np.float32(alpha.min()) / self._top)

    @property
    def has_alpha(self) -> bool:
        """Whether some pixel is not opaque (alpha below 0.999)."""
        return self.least_alpha() < 0.999

    def without_alpha(self) -> Raster:
        """The same image, opaque everywhere."""
        channels = self.stored.shape[-1]
        return self if channels in (1, 3) else replace(self, stored=self.stored[..., : channels - 1], associated=False)

    def alpha(self, step: int = 1) -> np.ndarray | None:
        """Alpha [h, w] float32 in 0..1 of every `step`-th pixel in both directions, from pixel step // 2 on.

        None where the file has no alpha, or where all of it is at least 0.999.
        """
        if not self.has_alpha:
            return None
        alpha = self.stored[step // 2 :: step, step // 2 :: step, -1].astype(np.float32) / self._top
        return np.clip(np.nan_to_num(alpha), 0.0, 1.0)

    def rows(self, start: int = 0, end: int | None = None) -> tuple[np.ndarray, np.ndarray | None]:
        """Radiance [h, W, 3] linear float32 of the rows start to end - 1, and alpha [h, W] in 0..1, or None without alpha.

        The radiance is that of Rec.709 primaries. Of a file with floats it may hold NaN, infinity and negative values; of
        any other file it is in 0..1.
        """
        part = self.stored[start:end]
        color = np.repeat(part[..., :1], 3, -1) if part.shape[-1] <= 2 else part[..., :3]
        alpha = part[..., -1].astype(np.float32) / self._top if part.shape[-1] in (2, 4) else None
        if alpha is not None and self.associated:
            color = _divided(color.astype(np.float32) / self._top, alpha)
        if self.is_float:
            color = color.astype(np.float32)
            if not self.encoding.is_linear:
                color = self.encoding.of_radiance(color)
            alpha = None if alpha is None else np.clip(np.nan_to_num(alpha), 0.0, 1.0)
        elif color.dtype.kind == "f":
            color = self.encoding.of_fractions(np.clip(color, 0, 1))
        elif self.encoding.is_linear:
            color = color.astype(np.float32) / self._top
        else:
            color = self.encoding.of_whole_numbers(color)
        return color, alpha


def _divided(color: np.ndarray, alpha: np.ndarray) -> np.ndarray:
    """Colors [h, W, 3] that were multiplied by alpha [h, W], divided by it; as they are where alpha is nearly 0."""
    with np.errstate(invalid="ignore", divide="ignore"):
        opaque = alpha[..., None]
        return np.where(opaque > 1e-4, color / np.maximum(opaque, 1e-4), color)
