"""Stage 1 in seconds, for tests."""

from dataclasses import replace

from blender_nep.presets import Preset, preset


def brief_preset(**fields) -> Preset:
    """The preset `preview` with few steps of few rays; `fields` changes its FieldsPreset."""
    p = preset("preview")
    return replace(
        p,
        environment=replace(p.environment, rays_per_step=768),
        fields=replace(
            p.fields,
            **{"background_steps": 6, "steps": 24, "object_rays": 256, "sphere_rays": 256, "outside_rays": 256, **fields},
        ),
    )
