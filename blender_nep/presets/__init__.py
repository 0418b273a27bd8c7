"""The presets: every number that a user or an ablation may change, with its unit and its source.

`preview`, `balanced` and `quality` run the same program; they differ in run time and error. Each part of the method has its
settings in a file of its own.
"""

from blender_nep.presets.environment import EnvironmentPreset
from blender_nep.presets.fields import REFINEMENTS, FieldsPreset
from blender_nep.presets.material import EVIDENCE, MaterialPreset
from blender_nep.presets.preset import PRESETS, Preset, preset
from blender_nep.presets.surface import SurfacePreset

__all__ = [
    "EVIDENCE",
    "PRESETS",
    "REFINEMENTS",
    "EnvironmentPreset",
    "FieldsPreset",
    "MaterialPreset",
    "Preset",
    "SurfacePreset",
    "preset",
]
