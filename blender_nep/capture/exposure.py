"""The exposure and white balance of each photo, where they differ: what a camera on automatic has done.

Many photos show the same surroundings, and what one of them shows brighter than the others do is its gain. The surroundings
are taken for spheres around the object, one of which is about as far as what a pixel shows: on each of them the photos are
laid into cells, and where cells agree between photos, they are compared. (F_e cannot tell: given differing photos it learns
haze before the cameras that makes them so.)
"""

from __future__ import annotations

import math

import numpy as np
import torch
from scipy import sparse
from torch.nn import functional

from blender_nep.capture.rays import PixelRays
from blender_nep.profile import profiled

SPHERES = (0.8, 1.2, 1.7, 2.4, 3.4, 5.0, 10.0, 1e4)
"""Radii in camera distances."""
ROWS = 64
"""Of cells on a sphere, twice as many columns."""
BLOCKS = 2500
"""Means over blocks of pixels are compared: so many a photo, and of all photos `MOST_BLOCKS`."""
MOST_BLOCKS = 300_000
ROUNDS = 8
"""Of solving and weighting."""
SMALLEST = 0.05
"""Differences of logarithms under which cells count as equal."""
LEAST_SPREAD = 0.12
"""Deviation of the logarithms from which on exposures differ: a sixth of a stop. What was found where they did not: 0.03 to
0.07, because the surroundings are no spheres."""
MOST_LEFT = 0.85
"""Share of the differences between photos that may be left with the gains found. Measured: 0.96 to 0.99 where all photos
share one exposure, 0.74 to 0.80 where they differ by a quarter of a stop, 0.24 to 0.37 of automatic ones."""
MOST_ERROR = 0.1
"""Standard error of the gains' logarithms, by how two halves of the surroundings differ. Measured: 0.007 to 0.03; 0.3 where
the object fills the photos."""
PATCH = 4
"""Cells across the patches that the halves consist of."""
DARK, WHITE = 3e-3, 0.97
"""Pixels beyond are left out, the second where files end at 1."""


@profiled("exposures")
def find_gains(rays: PixelRays) -> torch.Tensor | None:
    """How much brighter than the others each photo was taken: gains [views, 3] of geometric mean 1 in every channel.

    None where all have one exposure, or where that cannot be told. Takes a second for 60 photos.
    """
    if len(rays.outside) == 0:
        return None
    view, cell, value, count = _cells(rays)
    if len(view) == 0:
        return None
    log, left = _solve(view, cell, value, count, rays.views)
    if log.mean(1).std() < LEAST_SPREAD or left > MOST_LEFT:
        return None
    half = (cell // (2 * ROWS) % ROWS // PATCH + cell % (2 * ROWS) // PATCH) % 2
    one, other = (_solve(view[part], cell[part], value[part], count[part], rays.views)[0] for part in (half == 0, half == 1))
    if (one - other).std() / 2 > MOST_ERROR:
        return None
    return torch.from_numpy(np.exp(log).astype(np.float32)).to(rays.radiance.device)


def stops(gain: torch.Tensor) -> list[float]:
    """How much brighter than the mean each photo was taken, in stops: of gains [views, 3]."""
    return [round(float(g), 2) for g in gain.log().mean(1) / math.log(2)]


def _cells(rays: PixelRays) -> tuple[np.ndarray, ...]:
    """Photo [n], cell of a sphere [n], the mean logarithm [n, 3] of the one in the other, and of how many blocks [n]."""
    distance = float(rays.rays(torch.tensor(rays.offset[:-1], device=rays.radiance.device))[0].norm(dim=-1).median())
    usable = torch.zeros(rays.count, dtype=torch.bool, device=rays.radiance.device)
    for part in rays.outside.split(1 << 20):
        usable[part] = True
    ends = rays.brightest <= 1.001
    blocks = min(BLOCKS, max(64, MOST_BLOCKS // rays.views))
    found = []
    for view, (height, width) in enumerate(rays.size):
        side = max(1, round(math.sqrt(height * width / blocks)))
        rows, columns = height // side, width // side
        if rows == 0 or columns == 0:
            continue
        index = torch.arange(height * width, device=usable.device).reshape(height, width) + rays.offset[view]
        index = index[:rows * side, :columns * side].reshape(rows, side, columns, side).transpose(1, 2).reshape(-1, side**2)
        radiance = rays.radiance[index].float()
        mean = radiance.mean(1)
        good = usable[index].all(1) & (mean.amin(-1) > DARK)
        if ends:
            good &= (radiance <= WHITE).all(-1).all(-1)
        if not good.any():
            continue
        origins, directions, _ = rays.rays(index[good, side**2 // 2])
        value = mean[good].log().double().cpu().numpy()
        cell, of = _on_spheres(origins, directions, distance)
        cells, inverse, count = np.unique(cell, return_inverse=True, return_counts=True)
        sums = np.stack([np.bincount(inverse, value[of, channel], len(cells)) for channel in range(3)], 1)
        found.append((np.full(len(cells), view), cells, sums / count[:, None], count))
    return tuple(np.concatenate(parts) for parts in zip(*found, strict=True)) if found else (np.zeros(0),) * 4


def _on_spheres(origins: torch.Tensor, directions: torch.Tensor, distance: float) -> tuple[np.ndarray, np.ndarray]:
    """In which cells rays [n, 3] leave the spheres: cells [m], and whose [m]."""
    along = (origins * directions).sum(-1)
    cells, whose = [], []
    for k, radius in enumerate(SPHERES):
        inner = along**2 - origins.square().sum(-1) + (radius * distance) ** 2
        ray = (inner > 0).nonzero()[:, 0]
        t = -along[ray] + inner[ray].sqrt()
        point = functional.normalize(origins[ray] + t[:, None] * directions[ray], dim=-1)
        row = ((torch.asin(point[:, 2].clamp(-1, 1)) / math.pi + 0.5) * ROWS).long().clamp(0, ROWS - 1)
        column = ((torch.atan2(point[:, 1], point[:, 0]) / (2 * math.pi) + 0.5) * 2 * ROWS).long() % (2 * ROWS)
        cells.append(((k * ROWS + row) * 2 * ROWS + column).cpu().numpy())
        whose.append(ray.cpu().numpy())
    return np.concatenate(cells), np.concatenate(whose)


def _solve(view: np.ndarray, cell: np.ndarray, value: np.ndarray, count: np.ndarray, views: int) -> tuple[np.ndarray, float]:
    """Least absolute differences of value - gain(view) - mean(cell), each entry weighted by how well its cell agrees.
    Returns the logarithms [views, 3] of the gains and which share of the differences they leave.

    By iteratively reweighted least squares; the cells' means are eliminated from the equations.
    """
    cells = len(SPHERES) * ROWS * 2 * ROWS
    shared = np.bincount(cell, minlength=cells)[cell] > 1
    view, cell, value, base = view[shared], cell[shared], value[shared], np.sqrt(count[shared])
    log, weight, agreement = np.zeros((views, 3)), base, base

    def differences(log: np.ndarray, weight: np.ndarray) -> np.ndarray:
        """From the cells' means [n, 3]."""
        rest, total = value - log[view], np.maximum(np.bincount(cell, weight, cells), 1e-12)
        return rest - np.stack([np.bincount(cell, weight * rest[:, c], cells) / total for c in range(3)], 1)[cell]

    for _ in range(ROUNDS):
        table = sparse.csr_matrix((weight, (view, cell)), shape=(views, cells))
        share = sparse.csr_matrix((weight / np.bincount(cell, weight, cells)[cell], (view, cell)), shape=(views, cells))
        matrix = np.diag(np.bincount(view, weight, views)) - (share @ table.T).toarray()
        middle = max(np.trace(matrix) / views, 1e-12)
        matrix += middle * (1e-3 / views + 1e-4 * np.eye(views))  # their mean is free, and so are photos that share nothing
        difference = differences(log, weight)
        log = log + np.linalg.solve(matrix, np.stack([np.bincount(view, weight * d, views) for d in difference.T], 1))
        log -= log.mean(0)
        size = np.abs(differences(log, weight)).mean(1)
        disagreement = np.bincount(cell, weight * size, cells) / np.maximum(np.bincount(cell, weight, cells), 1e-12)
        agreement = base / np.maximum(disagreement[cell], SMALLEST) ** 3
        weight = agreement / np.maximum(size, SMALLEST)
    left = [float((agreement * np.abs(differences(gains, agreement)).mean(1)).sum()) for gains in (log, 0 * log)]
    return log, left[0] / max(left[1], 1e-12)
