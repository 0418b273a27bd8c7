"""Which photos show a point, unhidden, at what angle, and in what color.

A photo shows a point if the point lies in its frame, if the surface there faces the camera, and if nothing hides it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor
from torch.nn import functional

from blender_nep.capture.rays.pixel_rays import PixelRays


@dataclass(frozen=True)
class LinesOfSight:
    """Straight lines from points to a camera, in the unit frame."""

    points: Tensor
    """[k, 3] where they begin"""
    towards: Tensor
    """[k, 3] unit vectors from the points to the camera"""
    camera: Tensor
    """[3]"""
    index: Tensor
    """[k] int64: the number of each point among those that were asked about"""


class Occluder(Protocol):
    """What may hide points from a camera (`occluders`)."""

    def hides(self, lines: LinesOfSight) -> Tensor:
        """Whether something lies on each of k lines of sight: [k] bool."""


class Photos(Protocol):
    """Photos that can be asked for colors: `SmallPhotos`, `FullPhotos`."""

    rays: PixelRays
    views: range

    def sample(self, view: int, place: Tensor) -> Tensor:
        """Colors [k, 3] of a photo at image coordinates [k, 2] within -1..1; NaN where its pixels cannot be used."""


@dataclass(frozen=True)
class Visible:
    """Those k of n points that a photo shows."""

    index: Tensor
    """[k] int64, rising"""
    place: Tensor
    """[k, 2] image coordinates, as `PixelRays.project` gives them"""
    towards: Tensor
    """[k, 3] unit vectors from the points to the camera"""
    cosine: Tensor
    """[k] of the angle between the normal and the direction to the camera; NaN where no normals were given"""


@dataclass(frozen=True)
class Observation:
    """What a photo shows of n points: those k of them that it shows, and in what color."""

    view: int
    index: Tensor
    """[k] int64, rising"""
    towards: Tensor
    """[k, 3] unit vectors from the points to the camera"""
    cosine: Tensor
    """[k] of the angle between the normal and the direction to the camera; NaN where no normals were given"""
    color: Tensor
    """[k, 3], as the photos give it: `SmallPhotos` tone-mapped, `FullPhotos` linear"""


def visible(
    rays: PixelRays,
    view: int,
    points: Tensor,
    normals: Tensor | None = None,
    occluder: Occluder | None = None,
    *,
    least_cosine: float = -1.0,
    two_sided: bool = False,
    lift: float = 0.0,
) -> Visible:
    """Which of the points [n, 3] a photo shows: those in its frame, at a cosine above `least_cosine`, that nothing hides.

    normals [n, 3] are unit vectors. two_sided: both sides of the surface count. lift: the camera is looked at from so far
    above the surface, in the unit frame. points and normals lie on the device of `rays`.
    """
    place, ahead = rays.project(view, points)
    index = (ahead & (place.abs() < 1).all(-1)).nonzero()[:, 0]
    camera = rays.camera(view)[0].to(points)
    start = points[index]
    if normals is None:
        towards = functional.normalize(camera - start, dim=-1)
        cosine = torch.full_like(start[:, 0], torch.nan)
    else:
        normal = normals[index]
        if lift:
            start = start + lift * normal
        towards = functional.normalize(camera - start, dim=-1)
        cosine = (towards * normal).sum(-1)
        facing = (cosine.abs() if two_sided else cosine) > least_cosine
        index, start, towards, cosine = index[facing], start[facing], towards[facing], cosine[facing]
    if occluder is not None:
        free = ~occluder.hides(LinesOfSight(start, towards, camera, index))
        index, towards, cosine = index[free], towards[free], cosine[free]
    return Visible(index, place[index], towards, cosine)


def observe(
    photos: Photos,
    points: Tensor,
    normals: Tensor | None = None,
    occluder: Occluder | None = None,
    *,
    least_cosine: float = -1.0,
    lift: float = 0.0,
) -> Iterator[Observation]:
    """What each of the photos shows of points [n, 3]: one photo after the other, so that many photos take no more memory.

    The arguments are those of `visible`. A photo whose pixels cannot be used at a point does not show it.
    """
    for view in photos.views:
        shown = visible(photos.rays, view, points, normals, occluder, least_cosine=least_cosine, lift=lift)
        color = photos.sample(view, shown.place)
        usable = torch.isfinite(color).all(-1)
        yield Observation(view, shown.index[usable], shown.towards[usable], shown.cosine[usable], color[usable])


def colors_of(observations: Iterable[Observation], count: int) -> Tensor:
    """The colors [views, count, 3] of `count` points in all photos; NaN where a photo does not show a point."""
    rows = []
    for seen in observations:
        row = seen.color.new_full((count, 3), torch.nan)
        row[seen.index] = seen.color
        rows.append(row)
    return torch.stack(rows)


def chosen_views(views: int, most: int) -> range:
    """At most `most` of the photos 0 .. views - 1, spread evenly over them."""
    return range(0, views, max(1, -(-views // most)))
