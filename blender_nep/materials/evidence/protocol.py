"""What an evidence is: it may say something of the roughness of materials, and of their metallic.

An evidence gives likelihoods as costs (the smaller, the likelier), or a measure that the prediction and the photos must have
in common. It decides nothing. `decision` joins what all evidence says.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
import torch
from torch import Tensor

from blender_nep.materials.fitting import regions

if TYPE_CHECKING:
    from blender_nep.messages import Message
    from blender_nep.presets import MaterialPreset
    from blender_nep.shading.light_moments import LightMoments


@dataclass(frozen=True, eq=False)
class FittedMaterials:
    """K materials, the n photo samples that show them, and how well each hypothesis explains the samples of a material."""

    light: LightMoments
    """[n]"""
    target: Tensor
    """[n, 3] linear radiance of the samples"""
    position: np.ndarray
    """[n, 3] unit frame"""
    place: np.ndarray
    """[n] int64, the place of each sample (`hue.places`)"""
    label: Tensor
    """[n] int64 in 0..K-1, the material of each sample; -1: of none"""
    albedo: Tensor
    """[K, 3] as far as it is known"""
    metallic: Tensor
    """[K] as far as it is known"""
    cost: Tensor
    """[M, R, K] mean residual of each hypothesis: one of the M metallic values of the preset, one of R roughness values"""
    preset: MaterialPreset
    photo: Tensor
    """[n] int64, the photo of each sample"""

    def __len__(self) -> int:
        return len(self.metallic)

    @property
    def metals(self) -> list[int]:
        """The numbers of the metals."""
        return (self.metallic >= 0.5).nonzero().squeeze(-1).tolist()

    @property
    def dielectrics(self) -> list[int]:
        """The numbers of all others."""
        return (self.metallic < 0.5).nonzero().squeeze(-1).tolist()

    def samples_of(self, k: int) -> Tensor:
        """Indices [m] of the samples of material k."""
        return (self.label == k).nonzero().squeeze(-1)

    def region_of(self, samples: Tensor) -> Tensor:
        """The region [m] int64 of the surface in which each of the samples [m] (indices) lies."""
        region, _ = regions(self.position[samples.cpu().numpy()], self.preset.region)
        return torch.from_numpy(region).to(self.label.device)


@dataclass(frozen=True, eq=False)
class OfMetallic:
    """What one evidence says of the metallic of K materials."""

    cost: Tensor
    """[M, K] of each metallic value of the preset, up to a factor for each material"""
    told: dict[int, dict[str, float]]
    """{number of a material of which it says something: {quantity: value}, for the report}"""


@dataclass(frozen=True, eq=False)
class OfRoughness:
    """What one evidence says of the roughness of one material, at the R values of `roughness_scan`: one of both, or both."""

    cost: Tensor | None = None
    """[R] a likelihood. Values whose cost is little above the least are a range"""
    log_ratio: Callable[[int], float] | None = None
    """The log of (the measure of the prediction / that of the photos) at a row. It falls with the roughness"""
    weight: Tensor | float = 1.0
    """That of the samples from which the cost comes"""


class Evidence(Protocol):
    """Something that tells the roughness or the class of materials. Its name is in `presets.EVIDENCE`."""

    name: str

    def skipped(self, fitted: FittedMaterials) -> Message | None:
        """Why it does not apply to these materials. None if it does; it may still say nothing."""
        ...

    def of_metallic(self, fitted: FittedMaterials) -> OfMetallic | None:
        """What it says of the metallic. `fitted.metallic` and `fitted.albedo` do not count yet. None: nothing."""
        return None

    def of_roughness(self, fitted: FittedMaterials) -> dict[int, OfRoughness]:
        """{number of a material: what it says of its roughness}, with the metallic that was decided."""
        return {}
