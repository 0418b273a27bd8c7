"""Compares the colors that several photos show of the same point.

A point of a dull surface has the same color in all photos that show it. A wrong point falls on another place in each photo.
"""

from __future__ import annotations

import copy

import numpy as np
import torch
from scipy.ndimage import gaussian_filter
from torch import Tensor
from torch.nn import functional

from blender_nep.capture.rays.pixel_rays import PixelRays
from blender_nep.tone_mapping import inverse_tone_map, tone_map

AGREES = 0.04
"""Tone-mapped difference up to which two photos agree on a color."""
_CHUNK = 512
_VIEWS, _ROWS = 40, 200
"""Largest number of photos that are compared, and the rows and columns to which they are resized."""
_SMOOTH = 10.0
"""Standard deviation, in rows of the small photos, of the blur that `SmallPhotos.details` takes away."""


class SmallPhotos:
    """At most 40 small tone-mapped photos, in which the colors of points are compared."""

    def __init__(self, rays: PixelRays) -> None:
        self.rays = rays
        self.views = range(0, rays.views, max(1, -(-rays.views // _VIEWS)))
        photos = []
        for view in self.views:
            height, width = rays.size[view]
            index = torch.arange(rays.offset[view], rays.offset[view + 1], device=rays.radiance.device)
            photo = tone_map(rays.photo(index)).reshape(1, height, width, 3).permute(0, 3, 1, 2)
            photos.append(functional.adaptive_avg_pool2d(photo, (_ROWS, _ROWS)))
        self.photos = torch.cat(photos)

    def details(self) -> SmallPhotos:
        """The same photos without what changes slowly over them. What is left has both signs.

        A glossy table mirrors other surroundings for each camera. That changes slowly, and the table's pattern does not.
        """
        other = copy.copy(self)
        blurred = gaussian_filter(self.photos.cpu().numpy(), (0, 0, _SMOOTH, _SMOOTH), mode="nearest")
        other.photos = self.photos - torch.from_numpy(blurred).to(self.photos.device)
        return other

    def spread(self, points: np.ndarray) -> np.ndarray:
        """Median absolute difference [n] of the colors of points [n, 3] from their medians; NaN where hardly seen."""
        colors = self.colors(torch.from_numpy(points.astype(np.float32)).to(self.photos.device))
        seen = torch.isfinite(colors[..., 0]).sum(0) >= max(4, len(self.photos) // 4)
        spread = (colors - colors.nanmedian(0).values).abs().nanmedian(0).values.mean(-1)
        return torch.where(seen, spread, torch.nan).double().cpu().numpy()

    def agreement(self, points: Tensor, counts: Tensor | None = None) -> tuple[Tensor, Tensor, Tensor]:
        """The linear color [n, 3] of points [n, 3] on which most photos agree.

        Also the share [n] of the photos that agree, and the number [n] of photos that count. Only photos that show a point
        count; with counts [n, photos] bool, only those among them.
        """
        found = []
        for k, part in enumerate(points.split(_CHUNK)):
            seen = self.colors(part).transpose(0, 1)
            counted = torch.isfinite(seen[..., 0])
            if counts is not None:
                counted &= counts[k * _CHUNK : (k + 1) * _CHUNK]
            alike = (seen[:, :, None] - seen[:, None]).abs().mean(-1) < AGREES
            alike &= counted[:, :, None] & counted[:, None]
            most, best = alike.sum(2).max(1)
            chosen = alike[torch.arange(len(part), device=part.device), best]
            color = torch.where(chosen[..., None], seen, 0.0).sum(1) / most.clamp_min(1)[:, None]
            count = counted.sum(1)
            found.append((inverse_tone_map(color), most / count.clamp_min(1), count))
        color, share, count = (torch.cat(values) for values in zip(*found, strict=True))
        return color, share, count

    def colors(self, points: Tensor) -> Tensor:
        """Colors [views, n, 3] of points [n, 3]; NaN where a photo does not show the point."""
        found = [self.rays.project(view, points) for view in self.views]
        place, ahead = (torch.stack(part) for part in zip(*found, strict=True))
        colors = functional.grid_sample(self.photos, place[:, :, None], align_corners=False)[..., 0].transpose(1, 2)
        seen = ahead & (place.abs() < 1).all(-1)
        return torch.where(seen[..., None], colors, torch.nan)
