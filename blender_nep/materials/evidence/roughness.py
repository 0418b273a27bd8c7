"""Finds the roughness of materials from what tells it.

**Dielectrics.** How much of a dielectric's light comes from below its coat depends on the albedo and on the irradiance, and
small errors of the irradiance are as strong as the whole reflection. So four things are done:

- Each material has an albedo of its own in each small region of the surface. What is left to compare between the photos of a
  region is the reflection. These albedos are not used for anything else.
- A sample counts as far as its reflected light is in the photos. The unseen light is too coarse to tell a roughness.
- Dielectrics that the photos hardly tell apart in roughness share one: a bright glaze hides its reflections in the light
  from below, and a dark one shows them.
- Where the hue of a paint differs from that of the light, its reflections can be seen alone: see `diffuse_free`.

**Metals.** Normals are a little wrong, so reflections are misplaced. A misplaced reflection agrees best with a blurred one,
and the residual is least at a roughness that is too high. For mirrors the residual hardly changes there. How far the
radiance spreads about its mean does not depend on where the reflections are. So the residual gives a range of roughness
values, and within the range the spread decides. Lobes that are sharper than the light all have the spread of a mirror; among
these, the residual decides. If the photos vary more than a mirror would, the light or the shape lacks something that the
photos show, and the spread tells less: the residual then decides among lobes whose spreads differ by less than what is
missing.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from blender_nep.materials.fitting import fit_groups
from blender_nep.profiling import profiled

if TYPE_CHECKING:
    from blender_nep.presets import MaterialPreset
    from blender_nep.shading.light_moments import LightMoments

_LEAST_SAMPLES = 8
"""Least number of samples in a region. With fewer, its three albedos would follow the noise."""
_PLACES = 8
"""Places between two neighboring values of `roughness_scan`, so that the end of the lobes that are alike is found."""
_ALIKE = 0.02
"""Spreads whose logs differ by less are not told apart."""
_NO_LIMIT = 2.5
"""Largest regional albedo. It is above 1, because F_e may be too dark in a region."""


def weight_of_known_light(light: LightMoments) -> Tensor:
    """Weight [n] of the samples: 0.05 + the share of a sample's reflected light that the photos show.

    The narrower half of the roughness levels counts: wide lobes see much that no photo shows, and tell little.
    """
    return 0.05 + light.coverage[:, : light.coverage.shape[1] // 2].mean(1)


@profiled("roughness")
def residual_of_reflections(
    light: LightMoments,
    target: Tensor,
    position: np.ndarray,
    label: Tensor,
    materials: int,
    preset: MaterialPreset,
) -> tuple[Tensor, Tensor]:
    """The residual of each of the K materials, as a dielectric, at the R values of `roughness_scan`, with regional albedos.

    target [n, 3] linear; position [n, 3] in the unit frame; label [n] int64 in 0..K-1, or -1 for a sample that does not
    count. Returns the mean residual [R, K] and the weight of the samples [K] that it comes from; 0 where no region has
    enough samples.
    """
    weight = weight_of_known_light(light)
    voxel = np.floor(position / preset.region).astype(np.int64)
    place = np.concatenate([label.cpu().numpy()[:, None], voxel], 1)
    region, inverse, count = np.unique(place, axis=0, return_inverse=True, return_counts=True)
    used = (count >= _LEAST_SAMPLES) & (region[:, 0] >= 0)
    group = torch.from_numpy(np.where(used, np.arange(len(count)), -1)[inverse.ravel()]).to(target.device)
    cost, _ = fit_groups(
        light,
        target,
        weight,
        group,
        len(count),
        least_roughness=preset.least_roughness,
        clip=preset.clip,
        hypotheses=(0.0,),
        most_diffuse=_NO_LIMIT,
    )
    inside = group >= 0
    mass = torch.zeros(len(count), device=target.device).index_add_(0, group[inside], weight[inside])
    material = torch.from_numpy(region[used, 0]).to(target.device)
    mass, own = mass[torch.from_numpy(used)], (cost[0] * mass).T[torch.from_numpy(used)]
    total = torch.zeros(materials, device=target.device).index_add_(0, material, mass)
    summed = torch.zeros(materials, cost.shape[1], device=target.device).index_add_(0, material, own)
    return (summed / total.clamp_min(1e-9)[:, None]).T, total


def share_roughness(residual: Tensor, weight: Tensor, margin: float) -> Tensor:
    """The residuals [R, K] by which the roughness is chosen: those of the materials, or the mean of those that share one.

    weight [K] is that of the samples of each material. The common roughness is that with the least weighted mean of the
    residuals. A material whose residual it raises by more than the share `margin` leaves, and the others look for a common
    roughness again. A material without weight keeps its residual.
    """
    shared, chosen = weight > 0, residual.clone()
    while int(shared.sum()) > 1:
        together = (residual[:, shared] * weight[shared]).sum(1) / weight[shared].sum()
        worse = residual[together.argmin()] / residual.amin(0).clamp_min(1e-9) - 1
        worse = torch.where(shared, worse, torch.zeros_like(worse))
        if float(worse.max()) <= margin:
            chosen[:, shared] = together[:, None]
            break
        shared = shared & (worse < worse.max())
    return chosen


def spread(radiance: Tensor, weight: Tensor, region: Tensor) -> float:
    """Mean absolute deviation of the log radiance from its mean in each region; a change of exposure changes nothing.

    radiance [n] > 0, weight [n], region [n] int64. Regions of fewer than _LEAST_SAMPLES samples are left out; without any
    other region, the spread is 0.
    """
    values, count = torch.log(radiance), torch.bincount(region)
    total = torch.zeros(len(count), device=values.device).index_add_(0, region, weight)
    mean = torch.zeros(len(count), device=values.device).index_add_(0, region, weight * values) / total.clamp_min(1e-9)
    used = count[region] >= _LEAST_SAMPLES
    share = weight[used] / weight[used].sum().clamp_min(1e-9)
    return float((share * (values - mean[region])[used].abs()).sum())


def place_where_equal(residual: Tensor, margin: float, excess: Callable[[int], float]) -> float:
    """The place 0 .. R - 1 of a roughness in `roughness_scan`.

    residual [R]; all rows around the least one whose residual is at most 1 + `margin` times the least are possible.
    excess(row) is how much more the prediction varies than the photos; it falls with the roughness. The place is where it
    vanishes, or the end of the range that is nearest to that.
    """
    best, limit = int(residual.argmin()), float(residual.min()) * (1 + margin)
    low = high = best
    while low > 0 and residual[low - 1] <= limit:
        low -= 1
    while high < len(residual) - 1 and residual[high + 1] <= limit:
        high += 1
    before = excess(low)
    if before <= 0:
        return float(low)
    for row in range(low + 1, high + 1):
        after = excess(row)
        if after <= 0:
            return row - after / (after - before)
        before = after
    return float(high)


def place_by_both(residual: Tensor, margin: float, log_ratio: Callable[[int], float], alike: float) -> float:
    """The place 0 .. R - 1 of a roughness in `roughness_scan`, by the residual [R] and by another measure.

    log_ratio(row) is the log of (the measure of the prediction / that of the photos); it falls with the roughness. Within
    the range that the residual leaves, it decides (`place_where_equal`). Lobes that are sharper than the light have the
    measure of a mirror, which cannot tell them apart. So the residual does. What the residual says fades out where the
    measure falls below that of a mirror: half of it counts where the log is 0.75 `alike` lower, nothing where it is `alike`
    lower.
    """
    known = cache(log_ratio)  # it may be slow, and most materials need few rows
    place, rows = place_where_equal(residual, margin, known), np.arange(len(residual))
    beside = [int(place), min(int(place) + 1, len(rows) - 1)]
    drop = (known(0) - np.interp(place, beside, [known(row) for row in beside])) / alike
    if drop > 1:
        return place
    places = np.append(np.linspace(0, rows[-1], _PLACES * rows[-1] + 1), place)
    sharp = known(0) - np.interp(places, rows, [known(row) for row in rows.tolist()]) <= alike
    by_residual = places[sharp][np.interp(places, rows, residual.cpu().numpy())[sharp].argmin()]
    return float(place + min(2 - 2 * drop, 1.0) * (by_residual - place))


def place_of_metal(residual: Tensor, margin: float, log_ratio: Callable[[int], float]) -> float:
    """The place 0 .. R - 1 of a metal's roughness in `roughness_scan`, by the residual [R] and the spread (`place_by_both`).

    log_ratio(row) is the log of (spread of the prediction / spread of the photos). Where it is below 0 for a mirror, no lobe
    varies as much as the photos: fine relief or fine light is missing. Spreads are then wrong by that much at least, so
    spreads whose logs differ by less are not told apart.
    """
    known = cache(log_ratio)
    return place_by_both(residual, margin, known, max(_ALIKE, -known(0)))
