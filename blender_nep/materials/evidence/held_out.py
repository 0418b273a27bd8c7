"""How sure it is that photos which were held out are predicted better: a photo is what varies by chance."""

from __future__ import annotations

import math

from torch import Tensor

FOLDS = 4
"""Each photo is predicted from those of the other folds."""


def standard_errors(gain: Tensor, samples: Tensor) -> float:
    """The mean gain of a sample, as a multiple of its standard error over photos. 0 for a single photo.

    gain [photos] is the sum over the samples of a photo, and samples [photos] is their number; photos without samples do not
    count. All samples of a photo have one light, so their gains are not independent. The error is that of a ratio of sums
    (Cochran, Sampling Techniques, 6.4).
    """
    gain, samples = gain[samples > 0].double(), samples[samples > 0].double()
    photos = len(gain)
    if photos < 2:
        return 0.0
    rest = gain - gain.sum() / samples.sum() * samples
    return float(gain.sum()) / max(math.sqrt(float(rest.square().sum()) * photos / (photos - 1)), 1e-12)
