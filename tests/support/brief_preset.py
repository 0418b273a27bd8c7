"""Stage 1 in seconds, for tests."""

import math
from dataclasses import replace

from blender_nep.presets import Preset, preset


def brief_preset(**fields) -> Preset:
    """The preset `preview` with few steps of few rays and few cells, and without cavities.

    `fields` changes its FieldsPreset. The visual hull and the cavities would take longer than the steps.
    """
    p = preset("preview")
    brief = {"background_steps": 6, "steps": 24, "colors_first_steps": 1, "coarsest_cells": 8, "open_cavities_at": math.inf}
    few_rays = {"object_rays": 256, "sphere_rays": 256, "outside_rays": 256}
    return replace(
        p,
        environment=replace(p.environment, rays_per_step=768, coverage_rays=4096, detail_step=2),
        fields=replace(p.fields, **{**brief, **few_rays, **fields}),
    )
