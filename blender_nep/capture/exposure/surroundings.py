"""Finds the exposure and white balance of each photo by the surroundings that photos share.

Many photos show the same surroundings. If one photo shows the same surroundings brighter than the other photos do, the ratio
is its gain. How far the surroundings are is unknown. So several spheres around the object are tried at once, and several
horizontal planes below the cameras: one of them is about as far as what a pixel shows. The planes serve tables and floors.
Each photo is projected onto the cells of every sphere and plane. Cells that agree between the photos are then compared.
(F_e cannot find the gains: from photos that differ, F_e learns fog in front of the cameras.)
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from scipy import sparse
from torch.nn import functional

from blender_nep.capture.cameras.upright import upward
from blender_nep.capture.rays.pixel_rays import BRIGHTEST_CLIPPED, SATURATED, PixelRays
from blender_nep.capture.rays.vignetting import TERMS, Vignetting, falloff_terms
from blender_nep.messages import Message

SPHERES = (0.8, 1.2, 1.7, 2.4, 3.4, 5.0, 10.0, 1e4)
"""Radii of the spheres, as multiples of the cameras' median distance from the object's center."""
PLANES = (-0.1, -0.2, -0.3, -0.4, -0.5, -0.6, -0.7, -0.8, -0.9, -1.0, -1.3, -1.7, -2.2, -3.0, -4.0, -6.0)
"""Heights of the horizontal planes over the object's center, in object radii. None above the lowest camera is tried."""
LEAST_FALL = 0.05
"""Rays that fall by less than this per unit of their length are not compared in the planes, which they meet too far away."""
ROWS = 64
"""Rows of cells on a sphere; there are twice as many columns. A point of a plane lies in the cell of its direction as seen
from the object's center."""
BLOCKS = 2500
"""Means over square blocks of pixels are compared. A photo has about `BLOCKS` of them. With many photos each has fewer, so
that all photos together have about `MOST_BLOCKS`, but never fewer than about 64 a photo."""
MOST_BLOCKS = 300_000
BLOCK_SIDE = 6
"""The mean of a block is taken over at most this many rows and columns of its pixels."""
ROUNDS = 8
"""Rounds of reweighted least squares."""
SMALLEST = 0.05
"""Cells whose logarithms differ by less than this count as equal."""
GUESS = 0.003
"""Weight of the guess that all photos show equally bright things, relative to the weight of an average photo's cells. The
guess decides only where photos share no cells."""
LEAST_SHARED = 0.6
"""Share of a photo's cells that other photos show too, median over the photos. Under this share, exposures cannot be found.
Measured: 0.92 for 60 photos, 0.72 for 32, 0.45 for 16. With 16 photos, one capture's equal exposures seemed to differ."""
LEAST_SPREAD = 0.12
"""Standard deviation of the gains' logarithms from which on exposures count as different: a sixth of a stop. Measured on
photos with equal exposures: 0.03 to 0.08, because real surroundings are not spheres."""
MOST_LEFT = 0.85
"""Largest share of the differences between photos that may remain after the gains are divided out. Measured: 0.96 to 0.99
where all photos share one exposure, 0.74 to 0.80 where exposures differ by a quarter of a stop, 0.24 to 0.37 with automatic
exposure."""
MOST_LEFT_STILL = 0.65
"""The same on a turntable, where each place of the still room lies at one place of a row's photos. Measured: 0.997 where all
photos share one exposure; 0.69, 0.43 and 0.22 where exposures differ by a tenth, a quarter and half a stop. A real
turntable, whose still pixels hardly differ, has 0.82, because its photos were cropped and its plate turns."""
MOST_ERROR = 0.03
"""Largest error of the gains' logarithms, median over the photos. The error is estimated from two solutions, each of which
uses one half of the cells. Measured: 0.005 to 0.008; 0.09 where the object fills the photos."""
DOUBTFUL, FEW = 0.15, 0.05
"""A photo's gain is called a guess in two cases: the error of its logarithms is above `DOUBTFUL`, or the number of cells
that it shares with other photos is below `FEW` times the photos' median."""
OUTLYING, OUTLYING_DEVIATIONS = 0.75, 4.0
"""A photo is called darker or brighter than the others in two cases together: it differs by more than `OUTLYING` stops, and
by more than this many times the usual deviation of the photos. Measured on photos with equal exposures: up to 0.23 stops in
rooms; up to 1.2 stops with a usual deviation of 0.45 under an outdoor sky."""
LEAST_FALLOFF, MOST_FALLOFF = 0.1, 1.6
"""The logarithm of the corners' gain counts as vignetting between these sizes: a seventh of a stop, and more than two stops.
Measured on photos without vignetting: -0.012 to 0.1 in rooms, 0.3 above tables, 1.4 where the object fills the photos. So a
real vignetting is rather found too weak."""
CLEAR_FALLOFF = 0.2
"""... and its error, from the two halves of the cells, must be smaller than this share of it. Measured: 0.01 to 0.05."""
PATCH = 4
"""The two halves of the cells form a checkerboard of patches; a patch is this many cells wide and high."""
DARK = 0.01
"""Blocks darker than this share of their photo's median brightness are left out."""


@dataclass(frozen=True)
class _Entries:
    """One entry for each photo and each cell that it shows."""

    view: np.ndarray
    """[n]"""
    cell: np.ndarray
    """[n]"""
    value: np.ndarray
    """[n, 3]: mean log radiance"""
    terms: np.ndarray
    """[n, TERMS]: mean of `falloff_terms`"""
    count: np.ndarray
    """[n]: number of blocks in the cell"""
    brightness: np.ndarray
    """[views]: mean log radiance of each photo, NaN where a photo shows nothing"""

    def where(self, which: np.ndarray) -> _Entries:
        """The entries of which [n] bool is True."""
        of_entries = {name: getattr(self, name)[which] for name in ("view", "cell", "value", "terms", "count")}
        return replace(self, **of_entries)

    def shared(self) -> _Entries:
        """The entries of cells that more than one photo shows."""
        return self.where(np.bincount(self.cell)[self.cell] > 1) if len(self.cell) else self


@dataclass(frozen=True)
class Exposures:
    """The gains of the photos, if they differ."""

    gain: torch.Tensor | None
    """[views, 3]: how much brighter each photo was taken than the average. The geometric mean over the photos is 1 in every
    channel. None: all photos have one exposure, or the exposures cannot be found."""
    warning: Message | None = None
    vignetting: Vignetting | None = None
    """None: photos are not darker towards their corners, or nobody can tell."""


@dataclass(frozen=True)
class Comparison:
    """How bright the photos show the same surroundings, compared cell by cell."""

    log: np.ndarray
    """[views, 3]: logarithms of the gains; their mean over the photos is 0."""
    left: float
    """Share of the differences between the photos that remains after these gains are divided out"""
    shared: np.ndarray
    """[views]: number of a photo's cells that other photos show too"""
    falloff: np.ndarray
    """[TERMS]: coefficients of the vignetting"""
    on_turntable: bool
    """Whether the object turned, and camera and surroundings stood still"""
    _entries: _Entries

    @cached_property
    def evened_cells(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The photo [n] and the cell [n] of each entry, and its log radiance [n, 3] without gain and vignetting."""
        entries = self._entries
        value = entries.value - self.log[entries.view] - (entries.terms @ self.falloff)[:, None]
        return entries.view, entries.cell, value

    @cached_property
    def _halves(self) -> list[_Solution]:
        """Two solutions, each of which uses one half of the cells."""
        cell = self._entries.cell
        half = (cell // (2 * ROWS) % ROWS // PATCH + cell % (2 * ROWS) // PATCH) % 2
        return [_solve(self._entries.where(half == which)) for which in (0, 1)]

    @cached_property
    def error(self) -> np.ndarray:
        """Errors [views] of `log`, from two solutions, each of which uses one half of the cells. The first call solves."""
        one, other = (found.log for found in self._halves)
        return np.sqrt(((one - other) ** 2).mean(1)) / 2

    @cached_property
    def falloff_error(self) -> float:
        """Error of the logarithm of the corners' gain, from the same two solutions."""
        one, other = (found.falloff.sum() for found in self._halves)
        return abs(one - other) / 2

    def rest(self, log: np.ndarray) -> float:
        """How much photos differ where they show the same, if `log` [views, 3] are the logarithms of their gains.

        It is the mean of the logarithms' absolute differences, in which cells that agree between photos count most.
        """
        return _rest(self._entries, log, self.falloff)

    def exposures(self, device: torch.device | str = "cpu") -> Exposures:
        """The gains, if the photos differ and the gains are known well enough, and the vignetting alike."""
        vignetting = self.vignetting
        most_left = MOST_LEFT_STILL if self.on_turntable else MOST_LEFT
        if math.sqrt((self.log**2).mean()) < LEAST_SPREAD or self.left > most_left:
            return Exposures(None, vignetting=vignetting)
        if np.median(self.error) > MOST_ERROR:
            return Exposures(None, Message("capture.exposure_unclear"), vignetting)
        gain = torch.from_numpy(np.exp(self.log).astype(np.float32)).to(device)
        doubtful = int(((self.error > DOUBTFUL) | (self.shared < FEW * np.median(self.shared))).sum())
        warning = Message("capture.exposure_guessed", {"count": doubtful}) if doubtful else None
        return Exposures(gain, warning, vignetting)

    @property
    def vignetting(self) -> Vignetting | None:
        """How much darker the photos are towards their corners. None: they are not, or nobody can tell."""
        corner = float(self.falloff.sum())
        if not -MOST_FALLOFF < corner < -LEAST_FALLOFF or self.falloff_error > -CLEAR_FALLOFF * corner:
            return None
        found = Vignetting(*(float(c) for c in self.falloff))
        return found if found.darkest_at_corners else None

    def outliers(self) -> dict[int, float]:
        """{photo: how many stops it is brighter than the others}, for photos whose exposure clearly differs from the others.

        A few such photos do not make the exposures of a capture differ, so `exposures` may be silent about them.
        """
        off = (self.log.mean(1) - np.median(self.log.mean(1))) / math.log(2)
        usual = 1.4826 * np.median(np.abs(off))
        clear = np.abs(off) > max(OUTLYING, OUTLYING_DEVIATIONS * usual)
        if not clear.any() or np.median(self.error) > MOST_ERROR:
            return {}
        return {int(view): round(float(off[view]), 2) for view in np.flatnonzero(clear & (self.error < DOUBTFUL))}


def compare_exposures(rays: PixelRays) -> Comparison | None:
    """Compare how bright photos show the same surroundings; None if they share too little. Takes a second for 60 photos."""
    if len(rays.outside) == 0:
        return None
    entries = _cells(rays)
    view, cell = entries.view, entries.cell
    shown = np.bincount(view, minlength=rays.views)
    shared = np.bincount(view, np.bincount(cell)[cell] > 1, rays.views) if len(cell) else shown
    if np.median(shared / np.maximum(shown, 1)) < LEAST_SHARED:
        return None
    found = _solve(entries)
    return Comparison(found.log, found.left, shared, found.falloff, rays.turntable is not None, entries)


def stops(gain: torch.Tensor) -> list[float]:
    """How much brighter than the average each photo was taken, in stops, from its gains [views, 3]."""
    return [round(float(g), 2) for g in gain.log().mean(1) / math.log(2)]


def _cells(rays: PixelRays) -> _Entries:
    """One entry for each photo and each cell that it shows."""
    device = rays.radiance.device
    distance = float(rays.rays(torch.tensor(rays.offset[:-1], device=device)).origins.norm(dim=-1).median())
    planes = _Planes.of(rays)
    ends = rays.brightest <= BRIGHTEST_CLIPPED
    blocks = min(BLOCKS, max(64, MOST_BLOCKS // rays.views))
    found, brightness = [], np.full(rays.views, np.nan)
    for view, (height, width) in enumerate(rays.size):
        side = max(1, round(math.sqrt(height * width / blocks)))
        rows, columns = height // side, width // side
        if rows == 0 or columns == 0:
            continue
        corner = (
            rays.offset[view]
            + side * (torch.arange(rows, device=device)[:, None] * width + torch.arange(columns, device=device)).flatten()
        )
        inside = torch.arange(0, side, -(-side // BLOCK_SIDE), device=device)
        index = corner[:, None] + (inside[:, None] * width + inside).flatten()
        whole, mean = rays.valid[index].all(1), rays.in_files(index).mean(1)
        shown = mean[whole & (mean.amin(-1) > 0)]
        if not len(shown):
            continue
        brightness[view] = float(shown.log().mean())
        good = whole & (mean.amin(-1) > DARK * shown.median())
        if ends:
            good &= (rays.radiance[index] <= SATURATED).all(-1).all(-1)
        middle = corner + side // 2 * (width + 1)
        bundle = rays.rays(middle)
        origins, directions, _ = bundle
        along = -(origins * directions).sum(-1)
        good &= (along <= 0) | ((origins + along[:, None] * directions).square().sum(-1) >= 1)  # beside the object's sphere
        origins, directions, _ = bundle.in_room()  # where the surroundings stand still
        value = mean[good].log().double().cpu().numpy()
        terms = falloff_terms(rays.from_middle(middle[good])).double().cpu().numpy()
        if rays.turntable is not None:  # photos of a row show a place of the still room at one distance from their middles
            terms[:] = 0
        cell, of = _on_surfaces(origins[good], directions[good], distance, planes)
        cells, inverse, count = np.unique(cell, return_inverse=True, return_counts=True)
        of_cells = np.concatenate([value, terms], 1)[of]
        means = np.stack([np.bincount(inverse, column, len(cells)) for column in of_cells.T], 1) / count[:, None]
        found.append((np.full(len(cells), view), cells, means[:, :3], means[:, 3:], count))
    if not found:
        nothing = np.zeros(0, np.int64)
        return _Entries(nothing, nothing, np.zeros((0, 3)), np.zeros((0, TERMS)), nothing, brightness)
    view, cell, value, terms, count = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return _Entries(view, cell, value, terms, count, brightness)


@dataclass(frozen=True)
class _Planes:
    """The horizontal planes below the lowest camera."""

    up: torch.Tensor
    """[3]"""
    heights: tuple[float, ...]

    @classmethod
    def of(cls, rays: PixelRays) -> _Planes:
        positions, rotations = (
            torch.stack(part).double() for part in zip(*map(rays.camera, range(rays.views)), strict=True)
        )
        axes = rotations.cpu().numpy()
        up = torch.from_numpy(upward(axes[:, :, 0], axes[:, :, 1])).to(positions.device)
        lowest = float((positions @ up).min())
        return cls(up.float(), tuple(height for height in PLANES if height < lowest))

    def along(self, origins: torch.Tensor, directions: torch.Tensor) -> list[torch.Tensor]:
        """How far [n] along rays [n, 3] each plane lies; NaN for rays that do not fall steeply enough."""
        rise = directions @ self.up
        rise = torch.where(rise < -LEAST_FALL, rise, torch.nan)
        return [(height - origins @ self.up) / rise for height in self.heights]


def _on_surfaces(
    origins: torch.Tensor, directions: torch.Tensor, distance: float, planes: _Planes
) -> tuple[np.ndarray, np.ndarray]:
    """The cells [m] at which rays [n, 3] leave the spheres or meet the planes, and the index [m] of the ray at each."""
    along = (origins * directions).sum(-1)
    root = along**2 - origins.square().sum(-1)
    leaves = [(root + (radius * distance) ** 2).sqrt() - along for radius in SPHERES]  # NaN where a sphere is missed
    cells, whose = [], []
    for k, t in enumerate([*leaves, *planes.along(origins, directions)]):
        ray = (t > 0).nonzero()[:, 0]
        point = functional.normalize(origins[ray] + t[ray, None] * directions[ray], dim=-1)
        row = ((torch.asin(point[:, 2].clamp(-1, 1)) / math.pi + 0.5) * ROWS).long().clamp(0, ROWS - 1)
        column = ((torch.atan2(point[:, 1], point[:, 0]) / (2 * math.pi) + 0.5) * 2 * ROWS).long() % (2 * ROWS)
        cells.append(((k * ROWS + row) * 2 * ROWS + column).cpu().numpy())
        whose.append(ray.cpu().numpy())
    return np.concatenate(cells), np.concatenate(whose)


def _rest(entries: _Entries, log: np.ndarray, falloff: np.ndarray) -> float:
    """The mean absolute difference of the entries from the means of their cells, as in `Comparison.rest`."""
    entries = entries.shared()
    cell, base = entries.cell, np.sqrt(entries.count)
    evened = entries.value - log[entries.view] - (entries.terms @ falloff)[:, None]
    agreement = _agreement(cell, base, np.abs(_from_means(cell, evened, base)).mean(1), base)
    size = np.abs(_from_means(cell, evened, agreement)).mean(1)
    return float((agreement * size).sum() / max(agreement.sum(), 1e-12))


def _cell_count() -> int:
    """Number of cells on all spheres and planes."""
    return (len(SPHERES) + len(PLANES)) * ROWS * 2 * ROWS


def _from_means(cell: np.ndarray, values: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """The columns of values [n, k] minus the means of their cells [n] with weights [n]."""
    cells = _cell_count()
    total = np.maximum(np.bincount(cell, weight, cells), 1e-12)
    return values - np.stack([np.bincount(cell, weight * column, cells) / total for column in values.T], 1)[cell]


def _agreement(cell: np.ndarray, base: np.ndarray, size: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Weights [n] of entries: base [n], and more in cells whose differences of these sizes [n] are small."""
    cells = _cell_count()
    disagreement = np.bincount(cell, weight * size, cells) / np.maximum(np.bincount(cell, weight, cells), 1e-12)
    return base / np.maximum(disagreement[cell], SMALLEST) ** 3


@dataclass(frozen=True)
class _Solution:
    log: np.ndarray
    """[views, 3]: logarithms of the gains"""
    falloff: np.ndarray
    """[TERMS]: coefficients of the vignetting"""
    left: float
    """Share of the differences that remains with these gains and this vignetting"""


def _solve(entries: _Entries) -> _Solution:
    """Solve for the gains and the vignetting: minimize |value - log gain(view) - terms falloff - mean(cell)|.

    Each entry is weighted by how well its cell agrees between the photos. Iteratively reweighted least squares; the
    cells' means are eliminated from the equations. The gains and the vignetting are solved for in turn: they hardly depend
    on each other, because every photo shows cells at all distances from its middle.
    """
    cells, brightness = _cell_count(), entries.brightness
    views = len(brightness)
    entries = entries.shared()
    view, cell, value, terms, base = entries.view, entries.cell, entries.value, entries.terms, np.sqrt(entries.count)
    guess = np.nan_to_num(brightness - np.nanmean(brightness))[:, None].repeat(3, 1)
    log, falloff, weight, agreement = np.zeros((views, 3)), np.zeros(TERMS), base, base

    def differences(log: np.ndarray, falloff: np.ndarray, weight: np.ndarray) -> np.ndarray:
        """Differences [n, 3] of the entries, without gains and vignetting, from the weighted means of their cells."""
        return _from_means(cell, value - log[view] - (terms @ falloff)[:, None], weight)

    for _ in range(ROUNDS):
        table = sparse.csr_matrix((weight, (view, cell)), shape=(views, cells))
        share = sparse.csr_matrix((weight / np.bincount(cell, weight, cells)[cell], (view, cell)), shape=(views, cells))
        matrix = np.diag(np.bincount(view, weight, views)) - (share @ table.T).toarray()
        prior = GUESS * np.bincount(view, weight, views).mean()
        difference = differences(log, falloff, weight)
        right = np.stack([np.bincount(view, weight * d, views) for d in difference.T], 1) + prior * (guess - log)
        log = log + np.linalg.solve(matrix + prior * np.eye(views), right)
        log -= log.mean(0)
        slope = _from_means(cell, terms, weight)
        square = (weight[:, None] * slope).T @ slope + 1e-6 * weight.sum() * np.eye(TERMS)
        falloff = falloff + np.linalg.solve(square, (weight[:, None] * slope).T @ differences(log, falloff, weight).mean(1))
        size = np.abs(differences(log, falloff, weight)).mean(1)
        agreement = _agreement(cell, base, size, weight)
        weight = agreement / np.maximum(size, SMALLEST)
    left = [float((agreement * np.abs(differences(gains, falloff, agreement)).mean(1)).sum()) for gains in (log, 0 * log)]
    return _Solution(log, falloff, left[0] / max(left[1], 1e-12))
