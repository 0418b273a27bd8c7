"""Finds the support plane on which the object stands, before the object field is learned."""

from __future__ import annotations

from blender_nep.fields.refinements.hull import background_scores
from blender_nep.fields.refinements.refinement import Change
from blender_nep.fields.stage import StageOne
from blender_nep.fields.visual_hull import carve
from blender_nep.messages import Message, Part
from blender_nep.support.at_foot import support_at_foot
from blender_nep.support.in_photos import support_in_photos
from blender_nep.support.plane import Support


class SupportSearch:
    """Finds the plane by its pattern in the photos, or else by the shadow around the hull's foot."""

    name = Part.SUPPORT
    at = (0.0,)

    def skipped(self, stage: StageOne) -> Message | None:
        return None

    def apply(self, stage: StageOne) -> Change:
        found = support_in_photos(stage.rays)
        if found is None and not stage.scene.photos.masks and stage.schedule.background_steps:
            found = support_by_hull(stage)
        stage.stand_on(found)
        return Change(False) if found is None else Change(True, {"height": found.height})


def support_by_hull(stage: StageOne) -> Support | None:
    """The plane of a plain table, found with the hull's help. F_e must have been learned alone."""
    hull = carve(background_scores(stage))
    return None if hull is None else support_at_foot(stage.rays, hull.sdf)
