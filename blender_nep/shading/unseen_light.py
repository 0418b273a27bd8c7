"""The unseen light: light that no photo shows, but that the object reflects.

Photos of an object in a room show the walls behind it. They show the lamps on the ceiling only as highlights. There F_e has
no coverage. Without that light, the albedo would come out too bright, and paint would be taken for metal. So a map of
radiance takes the place of F_e there. In between, both count: F_e in proportion to its coverage, the map in proportion to
what is missing.

Where photos show nothing, F_e still holds some radiance: what it began with, and what its smoothness prior filled in. That
does not count as light, but it is what the map begins with (`UnseenLight.expected`).

The map is equirectangular (Blender's orientation, row 0 is +z) on a sphere of finite radius around the object's center, so
that near lamps keep their parallax. For fixed materials, the light in the photos is linear in the map: a sparse matrix times
the map (`unseen_transport`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from blender_nep.shading.environment import Environment

_LEAST_MISSING = 1e-3
"""Smallest weight of a texel, so that every cone has a mean."""


@dataclass(frozen=True, eq=False)
class UnseenLight:
    """A map of radiance on a sphere around the object's center."""

    radius: float
    """Of the sphere, in the unit frame; inf means infinitely far"""
    radiance: Tensor
    """[rows, 2 rows, 3] >= 0"""
    missing: Tensor
    """[rows, 2 rows] share of each texel that no photo shows, 1e-3 to 1. Means over several texels are weighted by it"""
    expected: Tensor
    """[rows, 2 rows, 3] the radiance that is likely before the object's reflections are known. Only the learning needs it"""

    @classmethod
    def uniform(cls, rows: int, radius: float, device: torch.device | str, radiance: float = 0.0) -> UnseenLight:
        """The same radiance everywhere, of which photos show nothing and black is expected."""
        everywhere = torch.full((rows, 2 * rows, 3), radiance, device=device)
        return cls(radius, everywhere, torch.ones(rows, 2 * rows, device=device), torch.zeros_like(everywhere))

    @classmethod
    def expected_beside(cls, environment: Environment, rows: int) -> UnseenLight:
        """The map of all radiance that F_e holds, shown by photos or not, as seen from the center."""
        _, coverage = environment.equirect(rows)
        expected = environment.extrapolated(rows)
        return cls(environment.typical_distance(), expected, (1 - coverage).clamp(_LEAST_MISSING, 1), expected)

    def grayed(self) -> UnseenLight:
        """The same light before anything is known of it: the mean of what is expected, gray, everywhere."""
        mean = self.expected.mean().expand_as(self.expected).contiguous()
        return replace(self, radiance=mean, expected=mean)

    def scaled(self, gain: float) -> UnseenLight:
        """The same light, `gain` times as bright."""
        return replace(self, radiance=self.radiance * gain)

    def __call__(self, origins: Tensor, directions: Tensor, half_angle: Tensor) -> Tensor:
        """Mean radiance [n, 3] in cones from origins [n, 3] along unit directions [n, 3] with half_angle [n] radians.

        Both are in the room's frame.
        """
        index, weight = taps(self.missing, self.radius, origins, directions, half_angle)
        return (pyramid(self.radiance, self.missing)[index] * weight[..., None]).sum(1)

    def state(self) -> dict:
        """The light as a dict of tensors and numbers, for a checkpoint."""
        return {"radius": self.radius, "radiance": self.radiance, "missing": self.missing}

    @classmethod
    def from_state(cls, state: dict) -> UnseenLight:
        """The inverse of `state`."""
        return cls(state["radius"], state["radiance"], state["missing"], torch.zeros_like(state["radiance"]))

    def equirect(self, height: int) -> Tensor:
        """The map at another resolution: radiance [height, 2 height, 3] as seen from the center."""
        weighted = torch.cat([self.radiance * self.missing[..., None], self.missing[..., None]], -1)
        fine = torch.nn.functional.pad(weighted.permute(2, 0, 1)[None], (1, 1, 0, 0), mode="circular")
        rows = len(self.radiance)
        fine = torch.nn.functional.interpolate(
            fine, (height, round((2 * rows + 2) * height / rows)), mode="bilinear", align_corners=False
        )
        border = (fine.shape[3] - 2 * height) // 2
        fine = fine[0, :, :, border : border + 2 * height].permute(1, 2, 0)
        return fine[..., :3] / fine[..., 3:]

    def completed(self, radiance: Tensor, coverage: Tensor) -> Tensor:
        """The whole light [h, 2 h, 3] from the center: that of F_e, radiance [h, 2 h, 3] and coverage [h, 2 h], and this."""
        more = self.equirect(len(radiance)).to(radiance.device)
        return radiance + more * (1 - coverage)[..., None]


def level_sizes(rows: int) -> list[int]:
    """Numbers of rows of the map's levels; each has half the rows of the level before."""
    sizes = [rows]
    while sizes[-1] % 2 == 0 and sizes[-1] > 8:
        sizes.append(sizes[-1] // 2)
    return sizes


def pyramid(values: Tensor, weight: Tensor) -> Tensor:
    """All levels of a map [rows, 2 rows, C] in one list [texels, C].

    Each level holds means, weighted by solid angle and by weight [rows, 2 rows] > 0.
    """
    levels, finest, channels = [values], len(values), values.shape[-1]
    mass = weight * torch.sin((torch.arange(finest, device=values.device) + 0.5) * math.pi / finest)[:, None]
    for rows in level_sizes(finest)[1:]:
        summed = (levels[-1] * mass[..., None]).reshape(rows, 2, 2 * rows, 2, channels).sum((1, 3))
        mass = mass.reshape(rows, 2, 2 * rows, 2).sum((1, 3))
        levels.append(summed / mass[..., None])
    return torch.cat([level.reshape(-1, channels) for level in levels])


def taps(missing: Tensor, radius: float, origins: Tensor, directions: Tensor, half_angle: Tensor) -> tuple[Tensor, Tensor]:
    """The four texels at which each cone meets the map: indices into `pyramid` [n, 4] and weights [n, 4].

    They are on the level whose texels are about as wide as the cone. The weights are bilinear, times what is `missing` of
    the texels, [rows, 2 rows]. They add up to 1.
    """
    rows = len(missing)
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
    weight = torch.stack([(1 - fy) * (1 - fx), (1 - fy) * fx, fy * (1 - fx), fy * fx], 1)
    weight = weight * pyramid(missing[..., None], torch.ones_like(missing))[index, 0]
    return index, weight / weight.sum(1, keepdim=True)


@dataclass
class UncoveredCones:
    """k cones of surface points that left the object in directions that the photos do not show well."""

    row: Tensor
    """[k] int64, ascending: index of the surface point"""
    direction: Tensor
    """[k, 3] unit vectors in the room's frame"""
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
