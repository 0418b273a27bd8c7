"""Photos at their full size, in which the colors of points are looked up."""

from __future__ import annotations

from enum import Enum, auto

import torch
from torch import Tensor
from torch.nn import functional

from blender_nep.capture.rays.pixel_rays import PixelRays
from blender_nep.evidence.observation import chosen_views


class Sampling(Enum):
    """How a photo is sampled between its pixels. Where a pixel that counts cannot be used, the color is NaN."""

    PIXEL = auto()
    """The pixel at the place, as it is"""
    FOUR_PIXELS = auto()
    """Interpolated between four pixels. Within half a pixel of the photo's edge there are no four"""
    TO_THE_EDGE = auto()
    """Interpolated between four pixels. Those beyond the photo's edge are black, so its rim is darker"""


class FullPhotos:
    """Some photos at full size; their colors are linear radiance, as `PixelRays.photo` gives it."""

    def __init__(self, rays: PixelRays, sampling: Sampling, most: int | None = None) -> None:
        """most: largest number of photos, spread evenly over all of them; None: all."""
        self.rays, self._sampling = rays, sampling
        self.views = range(rays.views) if most is None else chosen_views(rays.views, most)

    def sample(self, view: int, place: Tensor) -> Tensor:
        """Colors [k, 3] of a photo at image coordinates [k, 2] within -1..1; NaN where its pixels cannot be used."""
        how = {
            Sampling.PIXEL: self._pixel,
            Sampling.FOUR_PIXELS: self._four_pixels,
            Sampling.TO_THE_EDGE: self._to_the_edge,
        }
        return how[self._sampling](view, place)

    def _pixel(self, view: int, place: Tensor) -> Tensor:
        height, width = self.rays.size[view]
        column, row = ((place + 1) / 2 * torch.tensor([width, height], device=place.device)).floor().long().unbind(-1)
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        index = self.rays.offset[view] + (row * width + column).clamp(0, height * width - 1)
        return torch.where((inside & self.rays.valid[index])[:, None], self.rays.photo(index), torch.nan)

    def _four_pixels(self, view: int, place: Tensor) -> Tensor:
        height, width = self.rays.size[view]
        column, row = ((place[:, 0] + 1) / 2 * width - 0.5, (place[:, 1] + 1) / 2 * height - 0.5)
        inside = (column > 0) & (column < width - 1) & (row > 0) & (row < height - 1)
        color = torch.full((len(place), 3), torch.nan, device=place.device)
        color[inside] = self._interpolated(view, row[inside], column[inside])
        return color

    def _interpolated(self, view: int, row: Tensor, column: Tensor) -> Tensor:
        """Colors [k, 3] at fractional rows and columns [k], counted from the middle of the first pixel."""
        top, left = row.floor().long(), column.floor().long()
        down, right = (row - top)[:, None], (column - left)[:, None]
        usable, color = torch.ones_like(top, dtype=torch.bool), torch.zeros(len(top), 3, device=top.device)
        for dy, weight_y in ((0, 1 - down), (1, down)):
            for dx, weight_x in ((0, 1 - right), (1, right)):
                index = self.rays.offset[view] + (top + dy) * self.rays.size[view][1] + left + dx
                usable &= self.rays.valid[index]
                color = color + weight_y * weight_x * self.rays.photo(index)
        return torch.where(usable[:, None], color, torch.nan)

    def _to_the_edge(self, view: int, place: Tensor) -> Tensor:
        height, width = self.rays.size[view]
        first, last = self.rays.offset[view], self.rays.offset[view + 1]
        photo = self.rays.photo(torch.arange(first, last, device=place.device))
        photo = torch.where(self.rays.valid[first:last, None], photo, torch.nan)
        photo = photo.reshape(1, height, width, 3).permute(0, 3, 1, 2)
        return functional.grid_sample(photo, place[None, :, None], align_corners=False)[0, :, :, 0].T
