"""The unseen light: light that no photo shows, but that the object reflects.

Photos of an object in a room show the walls behind it. They show the lamps on the ceiling only as highlights. There F_e has
no coverage. Without that light, the albedo would come out too bright, and paint would be taken for metal. So a map of
radiance is added to F_e, weighted by the missing coverage.

Where photos show nothing, F_e still holds some radiance: what it began with, and what its smoothness prior filled in. That
may be brighter than the true light, and the map could only add to it. So F_e counts less there (`share_of_field`), and the
map begins with what F_e holds (`UnseenLight.expected`).

The map is equirectangular (Blender's orientation, row 0 is +z) on a sphere of finite radius around the object's centre, so
that near lamps keep their parallax. For fixed materials, the light in the photos is linear in the map: a sparse matrix times
the map (`unseen_transport`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import torch
from torch import Tensor

if TYPE_CHECKING:
    from blender_nep.shading.plenoptic import Environment

LEAST_COVERAGE = 0.2
"""From this coverage on, the radiance of F_e counts in full."""


def share_of_field(coverage: Tensor) -> Tensor:
    """How much the radiance of F_e counts in cones of some coverage [...]: 0..1, and 0 where no photo shows anything."""
    return (coverage / LEAST_COVERAGE).clamp(0, 1)


class UnseenLight:
    """A map of radiance [rows, 2 rows, 3] >= 0 on a sphere of `radius` in the unit frame; inf means infinitely far."""

    def __init__(self, rows: int, radius: float, device: torch.device | str) -> None:
        self.radius = radius
        self.radiance = torch.zeros(rows, 2 * rows, 3, device=device)
        self.expected = torch.zeros_like(self.radiance)
        """The radiance that is likely before the object's reflections are known. Only the learning needs it."""

    @classmethod
    def expected_beside(cls, environment: Environment, rows: int) -> UnseenLight:
        """The map that gives back what `share_of_field` takes from F_e in narrow cones, as seen from the centre.

        A wide cone that photos cover in part gets more than that.
        """
        radiance, coverage = environment.equirect(rows)
        light = cls(rows, environment.typical_distance(), radiance.device)
        light.expected = radiance * (1 - share_of_field(coverage))[..., None]
        light.radiance = light.expected.clone()
        return light

    def __call__(self, origins: Tensor, directions: Tensor, half_angle: Tensor) -> Tensor:
        """Mean radiance [n, 3] in cones from origins [n, 3] along unit directions [n, 3] with half_angle [n] radians."""
        index, weight = taps(len(self.radiance), self.radius, origins, directions, half_angle)
        return (pyramid(self.radiance)[index] * weight[..., None]).sum(1)

    def state(self) -> dict:
        """The light as a dict of tensors and numbers, for a checkpoint."""
        return {"radius": self.radius, "radiance": self.radiance}

    @classmethod
    def from_state(cls, state: dict) -> UnseenLight:
        """The inverse of `state`."""
        light = cls(len(state["radiance"]), state["radius"], state["radiance"].device)
        light.radiance = state["radiance"]
        return light

    def equirect(self, height: int) -> Tensor:
        """The map at another resolution: radiance [height, 2 height, 3] as seen from the centre."""
        fine = torch.nn.functional.pad(self.radiance.permute(2, 0, 1)[None], (1, 1, 0, 0), mode="circular")
        rows = len(self.radiance)
        fine = torch.nn.functional.interpolate(
            fine, (height, round((2 * rows + 2) * height / rows)), mode="bilinear", align_corners=False
        )
        border = (fine.shape[3] - 2 * height) // 2
        return fine[0, :, :, border : border + 2 * height].permute(1, 2, 0)

    def completed(self, radiance: Tensor, coverage: Tensor) -> Tensor:
        """The whole light [h, 2 h, 3] from the centre: that of F_e, radiance [h, 2 h, 3] and coverage [h, 2 h], and this."""
        more = self.equirect(len(radiance)).to(radiance.device)
        return radiance * share_of_field(coverage)[..., None] + more * (1 - coverage)[..., None]


def level_sizes(rows: int) -> list[int]:
    """Numbers of rows of the map's levels; each has half the rows of the level before."""
    sizes = [rows]
    while sizes[-1] % 2 == 0 and sizes[-1] > 8:
        sizes.append(sizes[-1] // 2)
    return sizes


def pyramid(radiance: Tensor) -> Tensor:
    """All levels of a map [rows, 2 rows, 3] in one list [texels, 3]. Each level holds means, weighted by solid angle."""
    levels = [radiance]
    for rows in level_sizes(len(radiance))[1:]:
        last = levels[-1]
        sine = torch.sin((torch.arange(2 * rows, device=last.device) + 0.5) * math.pi / (2 * rows))
        pair = (last * sine[:, None, None]).reshape(rows, 2, rows * 2, 2, 3).sum((1, 3))
        levels.append(pair / (2 * sine.reshape(rows, 2).sum(1))[:, None, None])
    return torch.cat([level.reshape(-1, 3) for level in levels])


def taps(rows: int, radius: float, origins: Tensor, directions: Tensor, half_angle: Tensor) -> tuple[Tensor, Tensor]:
    """The four texels at which each cone meets the map: indices into `pyramid` [n, 4] and bilinear weights [n, 4].

    They are on the level whose texels are about as wide as the cone.
    """
    if math.isfinite(radius):
        along = (origins * directions).sum(-1, keepdim=True)
        square = (origins * origins).sum(-1, keepdim=True)
        directions = origins + directions * ((along**2 - square + radius**2).clamp_min(0).sqrt() - along)
        directions = directions / directions.norm(dim=-1, keepdim=True).clamp_min(1e-9)
    sizes = level_sizes(rows)
    # A bilinear lookup has the variance of a disc with a radius of sqrt(2/3) texels. The level is the nearest such disc.
    wanted = torch.log2((half_angle / (math.sqrt(2 / 3) * math.pi / rows)).clamp_min(1e-6))
    level = wanted.round().long().clamp(0, len(sizes) - 1)
    size = torch.tensor(sizes, device=level.device)
    first = torch.cat([size.new_zeros(1), (2 * size * size).cumsum(0)])[level]
    height = size[level]
    width = 2 * height
    polar = torch.atan2(directions[:, :2].norm(dim=-1), directions[:, 2])
    around = torch.atan2(directions[:, 1], directions[:, 0])
    y = (polar / math.pi * height - 0.5).clamp(min=0)
    x = (0.5 - around / (2 * math.pi)) * width - 0.5
    row, column = y.floor(), x.floor()
    fy, fx = y - row, x - column
    row, column = row.long(), column.long()
    top, bottom = row.clamp_max(height - 1), (row + 1).clamp_max(height - 1)
    left, right = column % width, (column + 1) % width
    index = first[:, None] + torch.stack(
        [top * width + left, top * width + right, bottom * width + left, bottom * width + right], 1
    )
    return index, torch.stack([(1 - fy) * (1 - fx), (1 - fy) * fx, fy * (1 - fx), fy * fx], 1)


@dataclass
class UncoveredCones:
    """k cones of surface points that left the object in directions that the photos do not show well."""

    row: Tensor
    """[k] int64, ascending: index of the surface point"""
    direction: Tensor
    """[k, 3] unit vectors"""
    half_angle: Tensor
    """[k] radians"""
    share: Tensor
    """[k] missing coverage, 0..1"""
    weight: Tensor
    """[k, 1 + R] weights in the diffuse lobe, and in the specular lobe of each roughness level"""
    fresnel: Tensor
    """[k, 2] (1 - v.h)^5, and the Fresnel reflectance of a dielectric"""

    def __len__(self) -> int:
        return len(self.row)

    def __getitem__(self, index: Tensor) -> UncoveredCones:
        return UncoveredCones(*(value[index] for value in vars(self).values()))

    @classmethod
    def joined(cls, parts: Sequence[UncoveredCones]) -> UncoveredCones:
        """The cones of all parts, one part after the other."""
        return cls(*(torch.cat(values) for values in zip(*(vars(part).values() for part in parts), strict=True)))
