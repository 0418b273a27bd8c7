"""Carves the object again, when F_e knows the silhouettes better than at the start (`visual_hull.excess`)."""

from __future__ import annotations

from collections.abc import Callable

from torch import Tensor

from blender_nep.capture.rays.ray_bundle import RayBundle
from blender_nep.fields.refinements.refinement import Change
from blender_nep.fields.stage import StageOne
from blender_nep.fields.visual_hull import background_silhouettes, excess
from blender_nep.messages import Message, Part
from blender_nep.profiling import profiled


class Carving:
    """Takes from the object what F_e and the support plane alone explain, now that both are known better."""

    name = Part.CARVE

    def __init__(self, at: tuple[float, ...]) -> None:
        self.at = at

    def skipped(self, stage: StageOne) -> Message | None:
        if stage.scene.photos.masks:
            return Message("reason.masks_show_outline")
        if stage.rays.turntable is not None:
            return Message("reason.turntable_hides")
        return None if stage.schedule.background_steps else Message("reason.few_pixels_beside")

    @profiled("visual hull")
    def apply(self, stage: StageOne) -> Change:
        field, shape = stage.object_field, stage.object_field.shape()
        band, sdf = stage.band, field.sdf_in_cells()
        background: Callable[[RayBundle], Tensor] = stage.renderer.background
        if stage.scene.plane_colors is not None:
            background = stage.scene.plane_colors.texture(sdf).before(background)
        silhouettes = background_silhouettes(
            background, stage.rays, wanted=lambda rays: shape.near(rays.origins, rays.directions, band)
        )
        free = excess(stage.rays, silhouettes, sdf)
        if not free.any():
            return Change(False)
        field.add(stage.on_device(free))
        return Change(True, {"share": float((free > 0).sum() / (sdf < 0).sum())})
