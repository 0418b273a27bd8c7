"""Tells metal from dielectric by the hue of what differs between the photos of one place.

This is the dichromatic reflection model (Shafer, Using color to separate reflection components, 1985). A dielectric reflects
light in the hue of the light. Its own hue comes from the diffuse light, which is the same in all photos. So what differs
between the photos of a place has the hue of the light. A metal gives its own hue to all light, so the differences have it,
too. Where the reflections lie does not matter. So this holds where shape and light are too coarse to predict reflections.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from blender_nep.materials.evidence.protocol import Evidence, FittedMaterials, OfMetallic
from blender_nep.messages import Message, Part
from blender_nep.profiling import profiled

if TYPE_CHECKING:
    from blender_nep.shading.light_moments import LightMoments

_PLACE = 0.08
"""Width of a place, in object radii."""
_NORMAL_BINS = 1.2
"""A place is split by its normals, whose components are rounded after a multiplication by this."""
_LEAST_SAMPLES = 6
"""Least number of samples of a place. Fewer do not tell how much the photos differ."""
_LEAST_PLACES = 15
"""Least number of places of a group. With fewer, nothing is said."""
_LOBE = 0.28
"""Roughness of the lobe in which the light of the samples is compared. The hue hardly depends on it."""
_UNCLEAR, _CLEAR = 0.3, 0.5
"""Standard deviation of the photos of a place, relative to their mean. Above _CLEAR, the differences are reflections. Below
_UNCLEAR, they may come from a wrong shape. Then they have the hue of the object, whatever its class, and cannot say metal.
Measured: 0.1 to 0.25 for dull paints, 0.5 to 0.9 for metals of roughness up to 0.3, 0.65 for embossed gold."""
_HUE_NOISE = 0.15
"""Standard deviation of the error of a hue, in log radiance. White metals and white paints differ by less than this."""


class Hue(Evidence):
    """The hue of what differs between the photos."""

    name = Part.HUE

    def skipped(self, fitted: FittedMaterials) -> Message | None:
        return Message("reason.class_chosen") if len(fitted.preset.metallic) == 1 else None

    def of_metallic(self, fitted: FittedMaterials) -> OfMetallic:
        said = evidence_of_metal(fitted.light, fitted.target, fitted.place, fitted.label, len(fitted))
        metallic = torch.tensor(fitted.preset.metallic, device=said.device)[:, None]
        told = {k: {"metal": round(value, 3)} for k, value in enumerate(said.tolist()) if value}
        return OfMetallic(1 - fitted.preset.hue_margin * said * metallic, told)


def places(position: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """The place [n] int64 of samples at position [n, 3] (unit frame) with normal [n, 3]."""
    key = np.concatenate([np.floor(position / _PLACE), np.round(normal * _NORMAL_BINS)], 1).astype(np.int64)
    return np.unique(key, axis=0, return_inverse=True)[1].ravel()


@profiled("metal by hue")
def evidence_of_metal(light: LightMoments, target: Tensor, place: np.ndarray, group: Tensor, groups: int) -> Tensor:
    """How clearly the hues say metal (up to 1) or dielectric (down to -1) for each group of samples: [groups].

    target [n, 3] linear; place [n] of `places`; group [n] int64 in 0..groups-1, or -1 for a sample in no group. 0: the hues
    do not tell, because the group is gray or dull, or has too few places.

    Both the mean radiance and the differences between photos are divided by those of the reflected light, so that colored
    light does not count as a color of the object. The evidence is the log-likelihood ratio of the two classes, averaged over
    the channels: on a dielectric, the hue of the differences is that of the light (0), on a metal that of the mean.
    """
    member = group.cpu().numpy()
    used = np.flatnonzero(member >= 0)
    key, inverse, count = np.unique(
        np.stack([member[used], place[used]], 1), axis=0, return_inverse=True, return_counts=True
    )
    inverse = inverse.ravel()
    level = int((light.roughness_levels - _LOBE).abs().argmin())
    photos = _mean_and_variance(target.cpu().numpy()[used], inverse, count)
    lights = _mean_and_variance(light.specular[:, level, 0].cpu().numpy()[used], inverse, count)
    out = np.zeros(groups, np.float32)
    enough = count >= _LEAST_SAMPLES
    for k in range(groups):
        rows = np.flatnonzero(enough & (key[:, 0] == k))
        if len(rows) < _LEAST_PLACES:
            continue
        (mean, difference), (light_mean, light_difference) = (_hues(*values, rows) for values in (photos, lights))
        own, differing = mean - light_mean, difference - light_difference
        likelihood = (differing**2).sum() - ((differing - own) ** 2).sum()
        clear = np.clip((_relative_deviation(*photos, rows) - _UNCLEAR) / (_CLEAR - _UNCLEAR), 0, 1)
        out[k] = np.clip(likelihood / 3 / (2 * _HUE_NOISE**2), -1, clear)
    return torch.from_numpy(out).to(target.device)


def _mean_and_variance(values: np.ndarray, place: np.ndarray, count: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and variance [places, 3] of values [n, 3] in each place [n], which has `count` [places] samples."""
    values = values.astype(np.float64)

    def averaged(of: np.ndarray) -> np.ndarray:
        return np.stack([np.bincount(place, of[:, c], len(count)) for c in range(3)], 1) / count[:, None]

    mean = averaged(values)
    return mean, averaged((values - mean[place]) ** 2)


def _relative_deviation(mean: np.ndarray, variance: np.ndarray, rows: np.ndarray) -> float:
    """The median over the places `rows` of the standard deviation of the photos, relative to their mean."""
    return float(np.median(np.sqrt(variance[rows].mean(1)) / mean[rows].mean(1).clip(1e-6)))


def _hues(mean: np.ndarray, variance: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The hue [3] of the mean radiance and of its standard deviation, over the places `rows`: log radiance with mean 0.

    A place with a bright reflection counts as much as others.
    """
    mean, variance = mean[rows].clip(1e-6), variance[rows]
    square = mean.mean(1) ** 2
    weight = 1 / (square + variance.sum(1))
    deviation = 0.5 * np.log((variance * weight[:, None]).mean(0).clip(1e-12))
    average = np.log(mean).mean(0)
    return average - average.mean(), deviation - deviation.mean()
