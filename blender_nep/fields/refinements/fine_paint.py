"""Tells from the photos alone whether an object has fine paint: colors that change within a tenth of its radius.

For every place of the surface, the photos that show it are split into two halves: those from higher up, and those from lower
down. Each half gives the median color of the place. What these medians differ from those around them is fine paint, shading,
reflections or chance. Paint is the same in both halves. Reflections are not, because they show different parts of the
surroundings. Shading follows the normals, so what a linear function of the normals explains is taken away.
"""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor
from torch.nn import functional

from blender_nep.capture.cameras.upright import upward
from blender_nep.capture.rays.pixel_rays import PixelRays
from blender_nep.evidence.agreement import median_of_photos, views_that_show
from blender_nep.evidence.sdf_grid import SdfGrid
from blender_nep.evidence.small_photos import SmallPhotos
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
LEAST_VIEWS = 4
"""The color of a place is known if at least so many photos of a half show it."""
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
        found = fine_paint(stage.rays, start_sdf(stage.hull, stage.scene.support))
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
    grid = SdfGrid(sdf)
    shape = grid.traced_mesh()
    if shape is None:
        return 0.0
    surface, photos = grid.surface(), SmallPhotos(rays)
    points, normals = torch.from_numpy(surface.points), torch.from_numpy(surface.normals)
    halves = _halves(photos.surface_colors(points, normals, shape, inexact=grid.cell), photos, points, normals)
    shown = torch.stack([views_that_show(half) >= LEAST_VIEWS for half in halves]).all(0).numpy()
    if shown.sum() < LEAST_PLACES:
        return 0.0
    medians = np.concatenate([median_of_photos(half).numpy()[shown] for half in halves], 1)
    points, normals = surface.points[shown], surface.normals[shown]
    chosen = slice(None, None, -(-len(points) // MOST_PLACES))
    around = cKDTree(points).query(points[chosen], AROUND)[1]
    fine, bends = medians[chosen] - medians[around].mean(1), normals[chosen] - normals[around].mean(1)
    shading = np.concatenate([bends, bends * medians[chosen].mean(1, keepdims=True)], 1)
    fine = fine - shading @ np.linalg.lstsq(shading, fine, rcond=None)[0]
    from_above, from_below = fine[:, :3], fine[:, 3:]
    power = np.sqrt((from_above**2).mean() * (from_below**2).mean())
    return float((from_above * from_below).mean() / (power + FAINT**2))


def _halves(colors: Tensor, photos: SmallPhotos, points: Tensor, normals: Tensor) -> tuple[Tensor, Tensor]:
    """The colors [views, n, 3] that each place [n, 3] shows to the upper and to the lower half of its photos; else NaN."""
    axes = torch.stack([photos.rays.camera(view)[1] for view in photos.views]).double().cpu().numpy()
    up = torch.from_numpy(upward(axes[:, :, 0], axes[:, :, 1])).float()
    towards = functional.normalize(photos.cameras.cpu() - points[:, None], dim=-1)
    tangent = up - normals * (normals @ up)[:, None]
    height = (towards * tangent[:, None]).sum(-1).T
    height = torch.where(torch.isfinite(colors[..., 0]), height, torch.nan)
    above = (height > height.nanmedian(0).values)[..., None]
    return torch.where(above, colors, torch.nan), torch.where(above, torch.nan, colors)
