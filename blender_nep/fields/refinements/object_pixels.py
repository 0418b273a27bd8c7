"""Finds the pixels that show the object (`fields.object_pixels`), again and again while its shape becomes known."""

from __future__ import annotations

from blender_nep.fields.object_pixels import find_object_pixels, held_out_pixels
from blender_nep.fields.refinements.refinement import Change
from blender_nep.fields.stage import StageOne
from blender_nep.messages import Message, Part


class ObjectPixelSearch:
    """Finds the object pixels with the present SDF. Before the first validation, it also chooses the validation pixels.

    The first time, no object pixel counts as clear: F_e has not learned yet what stands in front of the object.
    """

    name = Part.OBJECT_PIXELS

    def __init__(self, at: tuple[float, ...]) -> None:
        self.at = at

    def skipped(self, stage: StageOne) -> Message | None:
        return None

    def apply(self, stage: StageOne) -> Change:
        shape, p = stage.object_field.shape(), stage.preset
        front = None if stage.object_pixels is None else stage.renderer.front(shape)
        found = find_object_pixels(stage.rays, shape, stage.band, front)
        stage.object_pixels = found
        if not stage.schedule.validation_errors:
            stage.validation_pixels = held_out_pixels(found.joined(), p.held_out_every, p.validation_pixels)
        return Change(True, {"pixels": len(found), "clear_pixels": len(found.clear)})
