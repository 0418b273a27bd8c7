"""Tells from the photos alone whether an object has fine paint: colors that change within a tenth of its radius.

For every place of the surface, the photos that show it are split into two halves: those from higher up, and those from lower
down. Each half gives the median color of the place. What these medians differ from those around them is fine paint, shading,
reflections or chance. Paint is the same in both halves. Reflections are not, because they show different parts of the
surroundings. Shading follows the normals, so what a linear function of the normals explains is taken away.
"""

from __future__ import annotations

import numpy as np
import torch
from scipy import ndimage
from scipy.spatial import cKDTree
from torch import Tensor
from torch.nn import functional

from blender_nep.capture.rays.pixel_rays import PixelRays
from blender_nep.evidence.surface_photos import SurfacePhotos, agreement, normals_of_cells, traced_mesh
from blender_nep.fields.refinements.hull import start_sdf
from blender_nep.fields.refinements.refinement import Change
from blender_nep.fields.stage import StageOne
from blender_nep.messages import Message, Part
from blender_nep.profiling import profiled

AROUND = 25
"""A place is compared with so many places around it. On the 64 cells of a hull, they lie within 0.1 radii."""
FAINT = 0.06
"""Fine colors that are weaker than this (tone-mapped) hardly count. At edges the background shines through in all photos.
A dull metal is darker in all its creases, which the surface does not have yet."""
MOST_PLACES, LEAST_PLACES = 20_000, 200
"""At most so many places are compared, and with fewer nothing is said."""


class FinePaint:
    """Gives the albedo a grid of fine paint if the photos show fine paint on the hull."""

    name = Part.FINE_PAINT
    at = (0.0,)

    def __init__(self, least: float) -> None:
        self._least = least

    def skipped(self, stage: StageOne) -> Message | None:
        return None if stage.hull is not None else Message("reason.no_hull")

    def apply(self, stage: StageOne) -> Change:
        assert stage.hull is not None
        found = fine_paint(stage.rays, start_sdf(stage.hull, stage.object_field.support))
        if found < self._least:
            return Change(False, {"correlation": found})
        stage.object_field.add_albedo_detail()
        return Change(True, {"correlation": found}, ("heads",))


@profiled("fine paint")
@torch.no_grad()
def fine_paint(rays: PixelRays, sdf: np.ndarray) -> float:
    """The correlation, -1..1, of the fine colors that photos from above and from below show on an SDF [n, n, n].

    Near 0: the object has no fine paint, or it is faint, or the photos do not show it. 0 where they show too little of the
    surface.
    """
    shape, solid, cell = traced_mesh(sdf), sdf < 0, 2 / len(sdf)
    if shape is None:
        return 0.0
    surface = solid & ndimage.binary_dilation(~solid)
    place = np.stack(np.nonzero(surface), -1)
    normals = normals_of_cells(sdf, place)
    points = ((place + 0.5) * cell - 1 - normals * sdf[surface][:, None]).astype(np.float32)
    photos = SurfacePhotos(rays)
    colors = photos.colors(torch.from_numpy(points), torch.from_numpy(normals), shape, cell)
    (high, _, known), (low, _, known_too) = (agreement(half) for half in _halves(colors, photos, points, normals))
    shown = (known & known_too).numpy()
    if shown.sum() < LEAST_PLACES:
        return 0.0
    points, normals, medians = points[shown], normals[shown], np.concatenate([high[shown].numpy(), low[shown].numpy()], 1)
    chosen = slice(None, None, -(-len(points) // MOST_PLACES))
    around = cKDTree(points).query(points[chosen], AROUND)[1]
    fine, bends = medians[chosen] - medians[around].mean(1), normals[chosen] - normals[around].mean(1)
    shading = np.concatenate([bends, bends * medians[chosen].mean(1, keepdims=True)], 1)
    fine = fine - shading @ np.linalg.lstsq(shading, fine, rcond=None)[0]
    from_above, from_below = fine[:, :3], fine[:, 3:]
    power = np.sqrt((from_above**2).mean() * (from_below**2).mean())
    return float((from_above * from_below).mean() / (power + FAINT**2))


def _halves(colors: Tensor, photos: SurfacePhotos, points: np.ndarray, normals: np.ndarray) -> tuple[Tensor, Tensor]:
    """The colors [views, n, 3] that each place [n, 3] shows to the upper and to the lower half of its photos; else NaN."""
    towards = functional.normalize(photos.cameras - torch.from_numpy(points)[:, None], dim=-1)
    tangent = photos.up - torch.from_numpy(normals) * (torch.from_numpy(normals) @ photos.up)[:, None]
    height = (towards * tangent[:, None]).sum(-1).T
    height = torch.where(torch.isfinite(colors[..., 0]), height, torch.nan)
    above = (height > height.nanmedian(0).values)[..., None]
    return torch.where(above, colors, torch.nan), torch.where(above, torch.nan, colors)
