"""Finds the silhouettes of a turntable's object from the photos alone: what turns, in front of what stands still.

All photos of a row are taken from one place. A pixel that shows the surroundings has the same color in all of them, but for
noise. So a color that recurs at a pixel is that of the surroundings, and a photo that differs from it shows the object. F_e
could not tell this: photos of a turntable show the surroundings behind the object from one place, and never all of them.

Colors of the object may recur, too, most of all near the axis, where no photo shows the surroundings. So the silhouettes
carve a first hull, whose gaps are closed. Then only the photos in which it does not cover a pixel tell the color of the
surroundings there. A pixel that is always covered counts as the object.

A printed plate turns with the object. So it differs from the surroundings that stand still, and would be taken for a part of
the object. `printed_plate` takes it out, if the plane of the plate is known.

What looks like the surroundings behind it is missing in a silhouette. A shadow that turns with the object is too much: it
counts little, because it only darkens the surroundings. The visual hull that all silhouettes carve together evens out both.
"""

from __future__ import annotations

import numpy as np
import torch
from scipy import ndimage
from torch import Tensor
from torch.nn import functional

from blender_nep.capture.rays.pixel_rays import PixelRays
from blender_nep.capture.rays.ray_bundle import RayBundle
from blender_nep.capture.turntable.rows import LEAST_PHOTOS
from blender_nep.evidence.sdf_grid import SdfGrid
from blender_nep.fields.printed_plate import PrintedPlate
from blender_nep.fields.visual_hull import VisualHull, carve, score_cells
from blender_nep.profiling import profiled
from blender_nep.support.plane import Support
from blender_nep.tone_mapping import inverse_tone_map, tone_map

RECURS = 0.15
"""A color recurs at a pixel if at least this share of the row's photos have it, and at least three."""
LEAST_DIFFERENCE = 0.02
"""Tone-mapped colors that differ by less may be the same, whatever the noise is."""
NOISE, USUAL = 2.5, 0.8
"""A color differs from that of the surroundings if the difference is larger than NOISE times the one that this share of the
pixels beside the object's sphere do not reach."""
SHADOW = (0.3, 1.0)
"""A shadow makes the surroundings darker by a factor within these limits, in all channels alike ..."""
SHADOW_HUE = 0.12
"""... but for this much of the factor's logarithm. Surroundings in a shadow are lit by other things, so hues change."""
SHADOW_COUNTS = 0.3
"""What may be a shadow counts by this factor as the object."""
LOWEST_SHARE = 0.1
"""The score of a cell is this quantile of its silhouette values over the photos (`visual_hull.score_cells`). It is twice
that of other silhouettes, because more are missing: a smooth object often looks as it did a turn before."""
FIRST_SHARE = 0.2
"""... and of the first hull, which may be too large but not too small"""
GAP = 0.06
"""Gaps of the first hull are closed in the photos if they are narrower than twice this share of the photo's longer side."""
BLOCKS = 100
"""Blocks along the shorter side of a photo, about"""
SAME_CAMERA = 1e-3
"""Cameras that are nearer to each other in the room, in object radii, and as turns in radians, are one that stands still."""
_CARVINGS, _LEAST_CARVED = 4, 0.02
"""On a printed plate, the hull is carved up to so many times more, as long as it loses this share of its volume."""
_TRIED = 12
"""Photos of a row whose colors are tried as those of the surroundings, at each pixel"""
_FIRST_CELLS = 48
"""Cells along each side of the cube in which the first hulls are carved"""
WIDEST_PLATE = 3.0
"""A plate is at most so large, in object radii."""
_DARK = 0.005
"""Radiance that is added before factors are compared, so that noise in the dark has no hue"""
_AT_A_TIME = 4096
"""Blocks that are looked at at a time"""


@profiled("silhouettes")
@torch.no_grad()
def still_silhouettes(rays: PixelRays, support: Support | None = None) -> list[Tensor]:
    """For each view [H / b, W / b]: how much its photo differs from the surroundings that stand still, 0 .. 1.

    From 0.5 on, it differs. The photos are averaged over blocks of b^2 pixels, so that about BLOCKS are left along the
    shorter side; b is at most 4. Blocks whose rays miss the object's sphere have 0. A photo from whose place fewer than two
    others were taken does not vote: its map is NaN. support: the plane on which the object stands, if it is known; what is
    printed on it counts as still. Takes 4 CPU seconds for 60 photos, and about 8 to 12 if the plane is known. Raises
    ValueError for rays without the motions of a turntable.
    """
    rows = rows_of(rays)
    block = min(max(1, round(min(min(size) for size in rays.size) / BLOCKS)), 4)
    first, beyond = _differences(rays, rows, block, None), None
    plate = None if support is None else PrintedPlate.of(rays, support, block)
    if plate is not None and not plate.is_seen(first):  # a print that is wider than the sphere turns beside it, too
        other = _differences(rays, rows, block, None, support)
        if plate.is_seen(other):
            first, beyond = other, support
        else:
            plate = None
    maps = first if plate is None else plate.taken_out(first)
    filled = [_without_holes(values) for values in maps]
    hull = carve(score_cells(rays, filled, _FIRST_CELLS, FIRST_SHARE), on_support=True)
    if hull is None:
        return maps
    maps = _differences(rays, rows, block, _covered_by(rays, hull, first), beyond)
    if plate is None:
        return maps
    for _ in range(_CARVINGS):
        maps, before = plate.taken_out(maps), hull.volume
        carved = carve(score_cells(rays, maps, _FIRST_CELLS, LOWEST_SHARE))
        if carved is None or carved.volume > (1 - _LEAST_CARVED) * before:
            break
        hull = carved
        plate = plate.beside(hull.sdf)
        maps = _differences(rays, rows, block, _covered_by(rays, hull, first), beyond)
    return plate.taken_out(maps)


def _covered_by(rays: PixelRays, hull: VisualHull, maps: list[Tensor]) -> list[Tensor]:
    """Where each view may show an object with this hull, in blocks like those of the maps."""
    grid = SdfGrid(hull.sdf)
    points = torch.from_numpy(grid.centers_of(grid.solid).astype(np.float32)).to(rays.radiance.device)
    return [_covered(rays, view, points, tuple(values.shape)) for view, values in enumerate(maps)]


def _differences(
    rays: PixelRays, rows: list[list[int]], block: int, covered: list[Tensor] | None, beyond: Support | None = None
) -> list[Tensor]:
    """The maps [H / block, W / block] of all views. covered: where each view may show the object; None: not known.

    beyond: a plane that turns. What shows it within WIDEST_PLATE does not tell how much still surroundings differ.
    """
    maps: list[Tensor] = [torch.empty(0)] * rays.views
    for views in rows:
        colors = torch.stack([_colors(rays, view, block) for view in views])
        shape = colors.shape[1:3]
        if len(views) < LEAST_PHOTOS:
            found = torch.full((len(views), shape[0] * shape[1]), torch.nan, device=colors.device)
        else:
            in_sphere = torch.stack([_meets_sphere(rays, view, shape) for view in views]).any(0).flatten()
            hidden = None if covered is None else torch.stack([covered[view] for view in views]).flatten(1)
            still = ~in_sphere
            if beyond is not None:
                still &= ~_shows_plate(rays, views[0], shape, beyond).flatten()
            found = _of_row(colors.flatten(1, 2), in_sphere, still, hidden)
        for view, values in zip(views, found, strict=True):
            maps[view] = values.view(shape)
    return maps


def _without_holes(values: Tensor) -> Tensor:
    """The map [rows, columns] with 1 in holes that what differs encloses, but for gaps of two blocks in its rim."""
    solid = np.pad(values.cpu().numpy() >= 0.5, 1)
    filled = ndimage.binary_fill_holes(ndimage.binary_closing(solid))[1:-1, 1:-1]
    return torch.where(torch.from_numpy(filled).to(values.device), 1.0, values)


def _covered(rays: PixelRays, view: int, points: Tensor, shape: tuple[int, ...]) -> Tensor:
    """Which blocks [rows, columns] bool of a photo points [n, 3] cover, without gaps, and the blocks beside these."""
    place, ahead = rays.project(view, points)
    size = torch.tensor([shape[1], shape[0]], device=place.device)
    column, row = ((place[ahead] + 1) / 2 * size).floor().long().cpu().numpy().T
    shown = np.zeros(shape, bool)
    inside = (row >= 0) & (row < shape[0]) & (column >= 0) & (column < shape[1])
    shown[row[inside], column[inside]] = True
    reach = max(2, round(GAP * max(shape)))
    shown = ndimage.binary_fill_holes(ndimage.binary_closing(np.pad(shown, reach), iterations=reach))
    shown = ndimage.binary_dilation(shown, iterations=2)[reach:-reach, reach:-reach]
    return torch.from_numpy(shown).to(place.device)


def rows_of(rays: PixelRays) -> list[list[int]]:
    """The views of each row: photos of one size, taken from one place of the room. Raises ValueError without motions."""
    if rays.turntable is None:
        raise ValueError("only the photos of a turntable have rows")
    origins, rotations = rays.cameras()
    places, turns = rays.turntable.points(origins), rays.turntable.rotation @ rotations
    rows: list[list[int]] = []
    for view in range(rays.views):
        for row in rows:
            first = row[0]
            near = max(float((places[view] - places[first]).norm()), float((turns[view] - turns[first]).norm()))
            if near < SAME_CAMERA and rays.size[view] == rays.size[first]:
                row.append(view)
                break
        else:
            rows.append([view])
    return rows


def _of_row(colors: Tensor, in_sphere: Tensor, still: Tensor, hidden: Tensor | None) -> Tensor:
    """The values [photos, n] of colors [photos, n, 3] at places of which in_sphere [n] may show the object.

    still [n]: places that tell how much still surroundings differ. hidden [photos, n]: where the object may cover the
    surroundings; None: not known.
    """
    found = torch.zeros(colors.shape[:2], device=colors.device)
    beside = still.nonzero()[:, 0]
    usual = 0.0
    if len(beside):
        some = colors[:, beside[:: max(1, len(beside) // _AT_A_TIME)]]
        usual = float((some - _recurring(some)[0]).abs().mean(-1).quantile(USUAL))
    limit = max(LEAST_DIFFERENCE, NOISE * usual)
    for part in in_sphere.nonzero()[:, 0].split(_AT_A_TIME):
        color, spread = _recurring(colors[:, part]) if hidden is None else _uncovered(colors[:, part], hidden[:, part])
        value = (0.5 * (colors[:, part] - color).abs().mean(-1) / limit).clamp(max=1)
        value = torch.where(_may_be_shadow(colors[:, part], color), SHADOW_COUNTS * value, value)
        value[:, spread > limit] = 1.0  # no photo shows the surroundings there
        found[:, part] = value
    return found


def _uncovered(colors: Tensor, hidden: Tensor) -> tuple[Tensor, Tensor]:
    """The median color [n, 3] of the photos that are not hidden [photos, n], of colors [photos, n, 3]; and 0, or infinity
    where all are hidden, [n]."""
    color = torch.where(hidden[..., None], torch.nan, colors).nanmedian(0).values
    none = hidden.all(0)
    return torch.where(none[:, None], 0.0, color), torch.where(none, torch.inf, 0.0)


def _recurring(colors: Tensor) -> tuple[Tensor, Tensor]:
    """The color [n, 3] that recurs best at each of n places, of colors [photos, n, 3], and how exactly it recurs [n].

    How exactly: the distance to the color of the last of the photos that are needed for it to recur.
    """
    photos = len(colors)
    needed = min(max(3, round(RECURS * photos)), photos)
    tried = colors[:: max(1, photos // _TRIED)]
    distance = torch.stack([(colors - one).abs().mean(-1).sort(0).values[needed - 1] for one in tried])
    spread, best = distance.min(0)
    center = tried[best, torch.arange(colors.shape[1], device=colors.device)]
    near = ((colors - center).abs().mean(-1) <= spread)[..., None]
    return (colors * near).sum(0) / near.sum(0), spread


def _may_be_shadow(colors: Tensor, still: Tensor) -> Tensor:
    """Whether tone-mapped colors [photos, n, 3] are those of the surroundings, still [n, 3], in a shadow: [photos, n]."""
    factor = ((inverse_tone_map(colors) + _DARK) / (inverse_tone_map(still) + _DARK)).log()
    mean = factor.mean(-1)
    low, high = (torch.tensor(limit).log() for limit in SHADOW)
    return (mean > low) & (mean < high) & ((factor - mean[..., None]).abs().amax(-1) < SHADOW_HUE)


def _colors(rays: PixelRays, view: int, block: int) -> Tensor:
    """The tone-mapped photo [H / block, W / block, 3], averaged over blocks."""
    height, width = rays.size[view]
    index = torch.arange(rays.offset[view], rays.offset[view + 1], device=rays.radiance.device)
    photo = tone_map(rays.photo(index)).view(1, height, width, 3).permute(0, 3, 1, 2)
    shape = (max(height // block, 1), max(width // block, 1))
    return functional.adaptive_avg_pool2d(photo, shape)[0].permute(1, 2, 0)


def _middles(rays: PixelRays, view: int, shape: tuple[int, ...]) -> RayBundle:
    """The rays through the middles of the blocks of a photo, shape [rows, columns], one after the other."""
    (height, width), (rows, columns) = rays.size[view], shape
    device = rays.radiance.device
    row = ((torch.arange(rows, device=device) + 0.5) * height / rows).long()
    column = ((torch.arange(columns, device=device) + 0.5) * width / columns).long()
    return rays.rays((rays.offset[view] + row[:, None] * width + column).flatten())


def _shows_plate(rays: PixelRays, view: int, shape: tuple[int, ...], plane: Support) -> Tensor:
    """Whether the blocks of a photo, shape [rows, columns] bool, show a plane within WIDEST_PLATE of the sphere's center."""
    bundle = _middles(rays, view, shape)
    normal = torch.as_tensor(np.asarray(plane.normal), dtype=bundle.origins.dtype, device=bundle.origins.device)
    t = (plane.height - bundle.origins @ normal) / (bundle.directions @ normal).clamp(max=-1e-6)
    points = bundle.origins + t[:, None] * bundle.directions
    return ((t > 0) & (bundle.directions @ normal < 0) & (points.norm(dim=-1) < WIDEST_PLATE)).view(shape)


def _meets_sphere(rays: PixelRays, view: int, shape: tuple[int, ...]) -> Tensor:
    """Whether the rays through the middles of the blocks of a photo meet the object's sphere, shape [rows, columns] bool."""
    bundle = _middles(rays, view, shape)
    along = -(bundle.origins * bundle.directions).sum(-1)
    meets = (along > 0) & ((bundle.origins + along[:, None] * bundle.directions).square().sum(-1) < 1)
    return meets.view(shape)
