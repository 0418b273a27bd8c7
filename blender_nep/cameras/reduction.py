"""Small copies of photos for the search of features, and the way from places in a copy to places in its photo."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from PIL import Image

from blender_nep.capture.cameras.camera import Camera


@dataclass(frozen=True)
class Reduction:
    """How a photo becomes a copy of `width` x `height` pixels, each `scale` photo pixels wide and high.

    A copy has whole pixels. So strips that are narrower than half a pixel of the copy are cut off at the photo's edges,
    `left` and `top` photo pixels wide, and the same at the right and the bottom. The copy has the photo's center, and one
    scale along both sides. With a scale for each side, square pixels would not stay square.
    """

    width: int
    height: int
    scale: float
    left: float
    top: float

    @classmethod
    def of(cls, width: int, height: int, longest: int) -> Reduction:
        """The reduction of a photo, so that no side of the copy is longer than `longest` pixels."""
        scale = max(1.0, max(width, height) / longest)
        columns, rows = (max(1, math.floor(side / scale + 1e-6)) for side in (width, height))
        left, top = (width - columns * scale) / 2, (height - rows * scale) / 2
        return cls(columns, rows, scale, max(0.0, left), max(0.0, top))

    def copy(self, image: Image.Image, resampling: Image.Resampling) -> Image.Image:
        """The copy of an image of the whole photo. The image may have another size than the photo, as masks may."""
        if image.size == (self.width, self.height):
            return image
        sides = zip((self.width, self.height), (self.left, self.top), image.size, strict=True)
        left, top = (cut / (pixels * self.scale + 2 * cut) * side for pixels, cut, side in sides)
        box = left, top, image.width - left, image.height - top
        return image.resize((self.width, self.height), resampling, box)

    def in_copy(self, camera: Camera) -> Camera:
        """The camera of the photo as one of the copy."""
        return replace(
            camera,
            width=self.width,
            height=self.height,
            fl_x=camera.fl_x / self.scale,
            fl_y=camera.fl_y / self.scale,
            cx=(camera.cx - self.left) / self.scale,
            cy=(camera.cy - self.top) / self.scale,
        )

    def in_photo(self, camera: Camera, width: int, height: int) -> Camera:
        """The camera of the copy as one of the photo, which has `width` x `height` pixels."""
        return replace(
            camera,
            width=width,
            height=height,
            fl_x=camera.fl_x * self.scale,
            fl_y=camera.fl_y * self.scale,
            cx=camera.cx * self.scale + self.left,
            cy=camera.cy * self.scale + self.top,
        )
