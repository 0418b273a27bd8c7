"""Starts the SDF from the visual hull of the object (`visual_hull`)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from torch import Tensor

from blender_nep.capture.rays.ray_bundle import RayBundle
from blender_nep.fields.refinements.refinement import Change
from blender_nep.fields.stage import StageOne
from blender_nep.fields.still_silhouettes import LOWEST_SHARE, still_silhouettes
from blender_nep.fields.visual_hull import (
    VisualHull,
    background_silhouettes,
    carve,
    mask_silhouettes,
    score_cells,
)
from blender_nep.messages import Message, Part
from blender_nep.profiling import profiled
from blender_nep.support.agreed_colors import AgreedColors
from blender_nep.support.foot import with_closed_foot
from blender_nep.support.plane import Support

_CARVINGS, _LEAST_CARVED = 8, 0.02
"""With the colors of the support plane, the visual hull is carved up to so many times, as long as it loses this share of its
volume."""


class HullStart:
    """Starts the SDF from the visual hull. If the silhouettes show no clear hull, the SDF stays as it is."""

    name = Part.HULL
    at = (0.0,)

    def skipped(self, stage: StageOne) -> Message | None:
        by_environment = not stage.scene.photos.masks and stage.rays.turntable is None
        if by_environment and not stage.schedule.background_steps:
            return Message("reason.few_pixels_beside")
        return None

    @profiled("visual hull")
    def apply(self, stage: StageOne) -> Change:
        rays = stage.rays
        if stage.scene.photos.masks:
            hull = carve(score_cells(rays, mask_silhouettes(rays), stage.cells))
        else:
            hull = hull_without_masks(stage)
        if hull is None or hull.contrast < stage.preset.least_contrast:
            return Change(False)
        stage.hull = hull
        stage.object_field.start_from(stage.on_device(start_sdf(hull, stage.scene.support)))
        stage.schedule.start_from_hull()
        return Change(True, {"volume": hull.volume, "contrast": hull.contrast})


def start_sdf(hull: VisualHull, support: Support | None) -> np.ndarray:
    """The SDF [n, n, n] with which learning starts: that of the hull, with a closed foot if it stands on a support plane."""
    return hull.sdf if support is None else with_closed_foot(hull.sdf, support)


def background_scores(stage: StageOne) -> np.ndarray:
    """Scores [n, n, n] of the SDF's cells: how much nearly all photos differ there from F_e alone (`score_cells`).

    On a turntable they differ from what stands still (`still_silhouettes`): F_e does not know what is behind the object. The
    scores are computed once before the first step of both fields.
    """
    if stage.cell_scores is None and stage.rays.turntable is not None:
        silhouettes = still_silhouettes(stage.rays, stage.scene.support)
        stage.cell_scores = score_cells(stage.rays, silhouettes, stage.cells, LOWEST_SHARE)
    if stage.cell_scores is None:
        stage.cell_scores = _scores(stage, stage.environment_alone)
    return stage.cell_scores


def hull_without_masks(stage: StageOne) -> VisualHull | None:
    """The hull from the residuals of F_e, as it is now, or from what turns on a turntable. None if F_e explains all.

    On a support plane, the hull is carved again: with a lower threshold, and with the colors of the plane. F_e does not know
    these colors. On a turntable, what stands still is known with the plane.
    """
    scores = background_scores(stage)
    hull = carve(scores)
    if hull is None:
        return None
    colors = stage.scene.plane_colors
    if colors is None or stage.rays.turntable is not None:
        return hull
    return _hull_on_support(stage, carve(scores, on_support=True) or hull, colors)


def _hull_on_support(stage: StageOne, hull: VisualHull, colors: AgreedColors) -> VisualHull:
    """The hull carved with the colors of the support plane, which are known better the smaller the hull is."""
    for _ in range(_CARVINGS):
        background = colors.texture(hull.sdf).before(stage.environment_alone)
        carved, before = carve(_scores(stage, background), on_support=True), hull.volume
        if carved is None:  # no usable hull would be left: the colors are not those of the plane
            break
        hull = carved
        if hull.volume > (1 - _LEAST_CARVED) * before:
            break
    return hull


def _scores(stage: StageOne, background: Callable[[RayBundle], Tensor]) -> np.ndarray:
    return score_cells(stage.rays, background_silhouettes(background, stage.rays), stage.cells)
