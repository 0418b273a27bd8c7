"""Tells how much the albedo follows light and shade. Wrong light that was taken for paint shows as such a correlation."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial import cKDTree

from blender_nep.materials.baking import LabeledPoints
from blender_nep.shading.incoming_light import IncomingLight

_BLACK = 0.01
"""Albedo and radiance that are added before a logarithm is taken."""
_UNIFORM = 1e-3
"""If the logarithm deviates by less than this, it follows nothing."""
_GLOSS = 0.1
"""Roughness at which the reflected light counts as highlight."""


def correlations(points: LabeledPoints, light: IncomingLight, position: np.ndarray) -> dict[str, float]:
    """Correlation, -1..1, of the log albedo with what the light does at n samples, whose positions are [n, 3].

    irradiance: with its logarithm. visibility: with the share of the hemisphere that the object does not hide, weighted by
    the cosine. highlights: with the logarithm of the light that a mirror-like surface would reflect to the photo. 0 if one
    of the two is uniform. A painted object may have a correlation by chance, and a uniform one has none.
    """
    nearest = cKDTree(points.position).query(position, workers=torch.get_num_threads())[1]
    albedo = np.log(points.albedo[nearest].mean(1) + _BLACK)
    traced = light.traced
    hidden = torch.zeros_like(light.cos_v).index_add_(0, traced.hit_index, traced.hit_weight[:, 0, 0])
    mirrored = light.moments(torch.tensor(_GLOSS, device=hidden.device)).full.mean(-1)
    causes = {
        "irradiance": (light.diffuse.mean(-1) + _BLACK).log(),
        "visibility": 1 - hidden,
        "highlights": (mirrored + _BLACK).log(),
    }
    return {name: round(_correlation(albedo, cause.float().cpu().numpy()), 3) for name, cause in causes.items()}


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    if a.std() < _UNIFORM or b.std() < _UNIFORM:
        return 0.0
    return float(np.corrcoef(a, b)[0, 1])
