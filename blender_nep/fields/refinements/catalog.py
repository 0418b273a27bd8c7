"""All refinements of stage 1, in the order in which they are applied."""

from __future__ import annotations

from blender_nep.fields.refinements.carve import Carving
from blender_nep.fields.refinements.cavities import CavityOpening
from blender_nep.fields.refinements.fine_paint import FinePaint
from blender_nep.fields.refinements.hidden_pixels import HiddenPixels
from blender_nep.fields.refinements.hull import HullStart
from blender_nep.fields.refinements.levels import FinestLevels
from blender_nep.fields.refinements.object_pixels import ObjectPixelSearch
from blender_nep.fields.refinements.refinement import Refinement
from blender_nep.fields.refinements.relief import ReliefSearch
from blender_nep.fields.refinements.support import SupportSearch
from blender_nep.presets import FieldsPreset


def refinements_of(preset: FieldsPreset) -> tuple[Refinement, ...]:
    """The refinements with the preset's fractions and limits. Those in `preset.without` are among them."""
    return (
        SupportSearch(),
        HullStart(),
        HiddenPixels(),
        FinePaint(preset.least_fine_paint),
        FinestLevels(preset.refine_at, preset.last_levels),
        Carving(preset.carve_again_at),
        CavityOpening(preset.open_cavities_at),
        ReliefSearch(preset.relief_at, preset.relief_pixels),
        ObjectPixelSearch(preset.object_pixels_at),
    )
