"""Finds relief that steps of learning do not find, by a search of tilted normals at each place of the surface.

A step follows the gradient of a few pixels. Relief tilts the mirrored direction across several things in the surroundings,
so the gradient of a flat surface does not lead to it. Here, each place of the surface is looked at in all photos together.
The colors of F_o are compared with the photos for the present normal, and for normals that are tilted to all sides.

Half of the photos find the same tilts as the other half where there is relief. Where they do not, the tilts are noise, and
the surface stays as it is. At last the SDF's fine level is fitted to the tilted normals, so that they belong to a surface.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from blender_nep.capture.rays.pixel_rays import PixelRays
from blender_nep.capture.rays.pixel_width import pixel_footprint
from blender_nep.capture.rays.rigid_motions import RigidMotions
from blender_nep.evidence.full_photos import FullPhotos, Sampling
from blender_nep.evidence.observation import LinesOfSight, observe
from blender_nep.evidence.sdf_grid import SdfGrid
from blender_nep.fields.object.field import ObjectField, Paint, SplineShape
from blender_nep.fields.object.fine_level import FineLevel
from blender_nep.fields.refinements.refinement import Change
from blender_nep.fields.stage import StageOne
from blender_nep.messages import Message, Part
from blender_nep.optimizers import Adam
from blender_nep.profiling import profiled, section
from blender_nep.tone_mapping import tone_map

RINGS = ((5.0, 6), (11.0, 10), (18.0, 14), (26.0, 18))
"""The tilts that are tried: (angle in degrees, number of directions)."""
LIKELY_TILT = 20.0
"""Degrees: larger tilts are less likely."""
CERTAINTY = 0.05
"""Two tilts differ clearly if their errors differ by this share of the mean error of all places."""
LARGEST_ERROR = 0.25
"""Tone-mapped; larger differences count as this, because something else is wrong there."""
AGREE_FROM, AGREE = 0.15, 0.3
"""Correlation of the tilts from both halves of the photos: up to the first they are noise, from the second on they count in
full. Measured on objects whose relief is known: 0.43 where the grid lacks relief, 0.02 to 0.15 where it lacks none."""
PROMISING = 0.05
"""Blocks in which a sample of the places agrees less are not searched."""
LEAST_SHARE = 0.03
"""The search ends early if hardly any place of a sample agrees: if the mean of its weights is below this."""
BLOCK = 12
"""Width of the blocks of the surface in which tilts are correlated, in cells of the fine level. Such a block has about 150
places, so that the correlation of noise stays below 0.12 or so."""
MOST_VIEWS = 60
"""At most so many photos are compared, spread evenly over all of them."""
LEAST_VIEWS = 4
"""A place counts if at least so many photos show it."""
_SAMPLE = 8
"""One of so many places is tried first."""
_FACING = 0.35
"""A photo shows a place if the cosine of the viewing angle is above this. At smaller ones, a pixel spans several places."""
_HIDDEN = 0.03
"""A photo shows a place if the surface lies at most so far before it, in object radii."""
_NEAR = 0.004
"""Rays end so near to the surface, in object radii. Seen at the most slanting angle, that is less than `_HIDDEN`."""
_CHUNK = 1 << 15
"""Observations whose colors are computed at a time; they fit into the processor's cache."""
_FIT_STEPS, _FIT_RATE, _HOLD = 200, 0.04, 0.05
"""The fit: its steps, their size in fine cells, and the weight of the surface's place, measured in half cells."""


@dataclass(frozen=True)
class Relief:
    """What a search has found."""

    share: float
    """Share of the places that got relief"""
    tilt_deg: float
    """Their mean tilt in degrees"""


class ReliefSearch:
    """Gives the SDF the relief that the photos show, if its grid is too coarse for it."""

    name = Part.RELIEF

    def __init__(self, at: tuple[float, ...], most_pixel: float) -> None:
        """most_pixel: the largest width of the photos' pixels, as a share of the SDF's cells."""
        self.at, self._most_pixel = at, most_pixel

    def skipped(self, stage: StageOne) -> Message | None:
        wide = pixel_footprint(stage.rays) > self._most_pixel * stage.object_field.cell
        return Message("reason.wide_pixels") if wide else None

    def apply(self, stage: StageOne) -> Change:
        found = find_relief(stage.object_field, stage.rays, self._most_pixel)
        return Change(False) if found is None else Change(True, asdict(found), ("sdf",))


class _Places(NamedTuple):
    """Places of the surface: points, unit normals and two tangents, all [n, 3]."""

    points: Tensor
    normals: Tensor
    tangent: Tensor
    bitangent: Tensor

    def of(self, chosen: Tensor | slice) -> _Places:
        return _Places(*(part[chosen] for part in self))

    def moved(self, motion: RigidMotions) -> _Places:
        """The places after n motions, one for each."""
        return _Places(motion.points(self.points), *(motion.directions(part) for part in self[1:]))


class _Observations(NamedTuple):
    """What photos show of the places."""

    place: Tensor
    """[m] int64"""
    direction: Tensor
    """[m, 3] unit, from the camera to the place"""
    color: Tensor
    """[m, 3] tone-mapped"""
    second: Tensor
    """[m] bool: whether the photo belongs to the second half of those that show the place"""
    motion: RigidMotions | None
    """m motions of the object to the room; None: the object stands still"""


class _Tilts(NamedTuple):
    """The tilts of places: slopes along tangent and bitangent."""

    slope: Tensor
    """[n, 2] from all photos"""
    variance: Tensor
    """[n] of the slope"""
    agreement: Tensor
    """[n] -1..1: the correlation of the slopes from both halves of the photos, in the place's block"""
    weight: Tensor
    """[n] 0..1: the trust in the slope"""


@profiled("relief")
def find_relief(field: ObjectField, rays: PixelRays, most_pixel: float = 0.25) -> Relief | None:
    """Give the SDF's fine level the relief that the photos show. None if they show none; then the field stays as it was.

    The photos cannot show it if a pixel is wider at the object's distance than the share `most_pixel` of the cells of the
    SDF's finest level. If there is a fine level already, the search begins from it.
    """
    if pixel_footprint(rays) > most_pixel * field.cell:
        return None
    cell = field.cell / 2
    with torch.no_grad():
        places = _surface_places(field, cell)
        promising = None if not len(places.points) else _promising(field, rays, places, BLOCK * cell * _SAMPLE**0.5)
        if promising is None:
            return None
        tilts = _search(field, rays, places.of(promising), _blocks(places.points[promising], BLOCK * cell))
        slope, variance = torch.zeros_like(places.points[:, :2]), torch.zeros_like(places.points[:, 0])
        slope[promising], variance[promising] = tilts.slope * tilts.weight[:, None], tilts.variance
        relief = promising.clone()
        relief[promising] = tilts.weight > 0
        if not relief.any():
            return None
        field.fine = FineLevel.at(places.points[relief], round(2 / cell), field.fine)
        held = field.fine.complete_at(places.points)
    target = places.normals + slope[:, :1] * places.tangent + slope[:, 1:] * places.bitangent
    _fit(field, places.of(held), functional.normalize(target[held], dim=-1), 1 / (variance[held] + 0.02))
    tilt = torch.rad2deg(torch.atan(slope[relief].norm(dim=-1)))
    return Relief(len(tilt) / len(slope), float(tilt.mean()))


def _promising(field: ObjectField, rays: PixelRays, places: _Places, width: float) -> Tensor | None:
    """The places [n] bool in whose block, `width` wide, a sample of places has tilts that agree; None if hardly any do."""
    block, some = _blocks(places.points, width), slice(None, None, _SAMPLE)
    tilts = _search(field, rays, places.of(some), block[some])
    if float(tilts.weight.mean()) < LEAST_SHARE:
        return None
    agreement = torch.zeros(int(block.max()) + 1, device=block.device)
    agreement[block[some]] = tilts.agreement
    return agreement[block] > PROMISING


@profiled("places")
def _surface_places(field: ObjectField, width: float) -> _Places:
    """The places of the zero level: one for each cell of that width through which it passes."""
    shape = field.shape()
    grid = SdfGrid(field.sdf_in_cells(round(2 / width)))
    centers = grid.centers_of(np.abs(grid.values) < 0.5 * width)
    near = torch.from_numpy(centers.astype(np.float32)).to(field.levels[0].device)
    for _ in range(2):
        sampled = shape.sample(near)
        square = sampled[:, 1:4].square().sum(-1, keepdim=True).clamp(min=0.1)
        near = near - (sampled[:, :1] * sampled[:, 1:4] / square).clamp(-width, width)
    normals = functional.normalize(shape.sample(near)[:, 1:4], dim=-1)
    other = torch.eye(3, dtype=near.dtype, device=near.device)[normals.abs().argmin(-1)]
    tangent = functional.normalize(torch.linalg.cross(normals, other), dim=-1)
    return _Places(near, normals, tangent, torch.linalg.cross(normals, tangent))


def _search(field: ObjectField, rays: PixelRays, places: _Places, block: Tensor) -> _Tilts:
    """The tilts that explain the photos best. `block` [n] are the numbers of the places' blocks."""
    with section("photos of places"):
        seen = _observe(field, rays, places)
    hypotheses = _hypotheses(places.points)
    errors, counts = _errors(field, places, seen, hypotheses)
    known = (counts.sum(0) >= LEAST_VIEWS) & (counts.min(0).values >= LEAST_VIEWS // 2)
    halves = errors / counts.clamp(min=1)[..., None]
    whole = errors.sum(0) / counts.sum(0).clamp(min=1)[:, None]
    certainty = CERTAINTY * float(whole[known, 0].mean()) if known.any() else 1.0
    first, second = (_mean_slope(half, hypotheses, 1.5 * certainty)[0] for half in halves)
    slope, variance = _mean_slope(whole, hypotheses, certainty)
    agreement = _correlation(first, second, known, block)
    weight = ((agreement - AGREE_FROM) / (AGREE - AGREE_FROM)).clamp(0, 1) * known
    return _Tilts(slope, variance, agreement, weight)


def _hypotheses(like: Tensor) -> Tensor:
    """The slopes [h, 2] that are tried; the first is no tilt."""
    tilts = [(0.0, 0.0)]
    for angle, count in RINGS:
        slope = math.tan(math.radians(angle))
        # each ring is turned by another angle, so that the directions of two rings do not coincide
        directions = [2 * math.pi * k / count + angle for k in range(count)]
        tilts += [(slope * math.cos(direction), slope * math.sin(direction)) for direction in directions]
    return torch.tensor(tilts, dtype=like.dtype, device=like.device)


class _SurfaceOccluder:
    """The surface of F_o, which hides what lies more than `_HIDDEN` behind it."""

    def __init__(self, shape: SplineShape) -> None:
        self._shape = shape

    def hides(self, lines: LinesOfSight) -> Tensor:
        """Whether the surface lies on each of k lines of sight: [k] bool."""
        distance = (lines.points - lines.camera).norm(dim=-1)
        origins, directions = lines.camera.expand(len(distance), 3).contiguous(), (-lines.towards).contiguous()
        entry = self._shape.interval(origins, directions)[0]
        spans, count = self._shape.march(origins, directions, entry, distance + _HIDDEN, _NEAR, _NEAR)
        return ~((count > 0) & (spans[:, 0, 0] > distance - _HIDDEN))


def _observe(field: ObjectField, rays: PixelRays, places: _Places) -> _Observations:
    """What the photos show of the places."""
    found, photos = [], FullPhotos(rays, Sampling.FOUR_PIXELS, MOST_VIEWS)
    for seen in observe(photos, places.points, places.normals, _SurfaceOccluder(field.shape()), least_cosine=_FACING):
        found.append((seen.index, -seen.towards, tone_map(seen.color), torch.full_like(seen.index, seen.view)))
    place, directions, color, view = (torch.cat(part) for part in zip(*found, strict=True))
    order = place.argsort(stable=True)
    place = place[order]
    rank = torch.arange(len(place), device=place.device) - torch.searchsorted(place, place)
    return _Observations(place, directions[order], color[order], rank % 2 == 1, rays.motion_in(view[order]))


def _errors(field: ObjectField, places: _Places, seen: _Observations, slopes: Tensor) -> tuple[Tensor, Tensor]:
    """Sums [2, n, h] of the tone-mapped errors of F_o's colors for both halves of the photos, and their counts [2, n]."""
    n, device = len(places.points), places.points.device
    slot = seen.place + n * seen.second
    counts = torch.zeros(2 * n, device=device).index_add(0, slot, torch.ones(len(slot), device=device))
    errors = torch.zeros(2 * n, len(slopes), device=device)
    paints = [field.paint(points) for points in places.points.split(_CHUNK)]
    paint = Paint(*(torch.cat(part) for part in zip(*paints, strict=True)))
    for chunk in torch.arange(len(slot), device=device).split(_CHUNK):
        k = seen.place[chunk]
        here, directions = places.of(k), seen.direction[chunk]
        paint_here = Paint(*(part[k] for part in paint))
        found = []
        if seen.motion is not None:
            here, directions = here.moved(seen.motion[chunk]), seen.motion[chunk].directions(directions)
        for slope in slopes:
            normals = functional.normalize(here.normals + slope[0] * here.tangent + slope[1] * here.bitangent, dim=-1)
            color = field.lit(paint_here, here.points, normals, directions).color
            found.append((tone_map(color) - seen.color[chunk]).abs().mean(-1).clamp(max=LARGEST_ERROR))
        errors.index_add_(0, slot[chunk], torch.stack(found, 1))
    return errors.view(2, n, -1), counts.view(2, n)


def _mean_slope(errors: Tensor, slopes: Tensor, certainty: float) -> tuple[Tensor, Tensor]:
    """The mean slope [n, 2], weighted by how well each slope [h, 2] explains the photos, and its variance [n].

    errors [n, h]: a slope whose error is larger by `certainty` than the least has a weight smaller by the factor e.
    """
    unlikely = (torch.rad2deg(torch.atan(slopes.norm(dim=-1))) / LIKELY_TILT).square()
    weight = torch.softmax(-(errors - errors.min(1, keepdim=True).values) / certainty - unlikely, 1)
    mean = weight @ slopes
    return mean, (weight @ slopes.square().sum(-1) - mean.square().sum(-1)).clamp(min=0)


def _blocks(points: Tensor, width: float) -> Tensor:
    """The block [n] int64 of each point [n, 3], numbered from 0 without gaps."""
    cell = torch.floor(points / width).long()
    return cell.unique(dim=0, return_inverse=True)[1]


def _correlation(first: Tensor, second: Tensor, known: Tensor, block: Tensor) -> Tensor:
    """The correlation [n] of two estimates [n, 2] of the slope, over the known places of the same block."""
    blocks = int(block.max()) + 1

    def total(values: Tensor) -> Tensor:
        return torch.zeros(blocks, device=values.device).index_add(0, block, values * known)

    product = total((first * second).sum(-1))
    power = (total(first.square().sum(-1)) * total(second.square().sum(-1))).sqrt()
    return (product / power.clamp(min=1e-12))[block]


def _fit(field: ObjectField, places: _Places, target: Tensor, weight: Tensor) -> None:
    """Fit the fine level to the target normals [n, 3]; the surface stays near its place."""
    assert field.fine is not None
    generator = torch.Generator(places.points.device).manual_seed(0)
    parameter, weight = field.fine.coefficients, (weight / weight.mean())[:, None]
    cell = 2 / field.fine.cells
    coarse = SplineShape(field.coefficients().detach(), field.support, field.fine.bricks)
    optimizer = Adam([parameter], lr=_FIT_RATE * cell)
    with section("fit"):
        for step in range(_FIT_STEPS):
            for group in optimizer.param_groups:
                group["lr"] = _FIT_RATE * cell * (1 if step < 0.7 * _FIT_STEPS else 0.2)
            off = (torch.rand(len(target), 1, generator=generator, device=target.device) - 0.5) * cell
            found = coarse.sample(places.points + off * places.normals)
            slant = (weight * (found[:, 1:4] - target).square()).sum(-1).mean()
            moved = ((found[:, :1] - off) / (0.5 * cell)).square().mean()
            optimizer.zero_grad()
            (slant + _HOLD * moved).backward()
            optimizer.step()
    parameter.grad = None
