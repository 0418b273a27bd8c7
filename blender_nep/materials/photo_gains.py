"""How much brighter each photo shows the object than the others do, though its surroundings are evened out.

Exposures are evened out by EXIF and by the surroundings. What is left on the object has many reasons: clouds before the sun,
the photographer's shadow, and cameras that brighten the dark parts of a picture. All samples of a photo have it in common.
So the photos are compared with what the materials of small regions predict, and the ratio is the gain of a photo. Photos
with few samples keep a gain near 1.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor

from blender_nep.profiling import profiled

if TYPE_CHECKING:
    from blender_nep.materials.samples.photo_samples import PhotoSamples

BLACK = 0.005
"""Radiance that is added before a logarithm is taken, so that noise in the dark does not count."""
USUAL = 0.2
"""Usual standard deviation of the gains' logarithms, where there are any"""
LEAST_SPREAD = 0.08
"""Gains count if their logarithms have this standard deviation."""
_ITERATIONS = 5
_SMALLEST = 0.1
"""Logarithms that differ by less count as equal."""


@profiled("photo gains")
def gains_of_photos(samples: PhotoSamples, predicted: Tensor, region: Tensor, weight: Tensor, photos: int) -> Tensor | None:
    """The gain [photos] of each photo, from its samples; 1 without any. None: the photos do not differ.

    predicted [n, 3] is the radiance that the n samples would have with the best material of their region [n] int64; weight
    [n] is how much a sample counts.
    """
    log = ((samples.radiance.mean(-1) + BLACK) / (predicted.mean(-1) + BLACK)).log()
    regions, shown = int(region.max()) + 1, torch.bincount(samples.photo, minlength=photos) > 0
    gain, place = torch.zeros(photos, device=log.device), torch.zeros(regions, device=log.device)
    for _ in range(_ITERATIONS):
        left = log - gain[samples.photo] - place[region]
        robust = weight * _SMALLEST / left.abs().clamp_min(_SMALLEST)
        noise = float((robust * left**2).sum() / robust.sum())
        place = _means(log - gain[samples.photo], robust, region, regions, 1.0)
        gain = _means(log - place[region], robust, samples.photo, photos, noise / USUAL**2)
        gain = torch.where(shown, gain - gain[samples.photo].mean(), 0.0)
    spread = float(gain[samples.photo].std())
    return gain.exp() if spread >= LEAST_SPREAD else None


def _means(values: Tensor, weight: Tensor, group: Tensor, groups: int, more: float) -> Tensor:
    """Weighted mean of the values [n] of each group; `more` is the weight of a zero that is added to each."""
    zero = torch.zeros(groups, device=values.device)
    return zero.index_add(0, group, values * weight) / (zero.index_add(0, group, weight) + more)
