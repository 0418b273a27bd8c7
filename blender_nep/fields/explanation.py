"""Whether the object's sphere holds an object at all."""

from __future__ import annotations

import torch
from torch.nn import functional

from blender_nep.capture.pixel_rays import PixelRays
from blender_nep.errors import LearningError
from blender_nep.fields.rendering import FieldsRenderer, RayBundle
from blender_nep.tone_mapping import tone_map


@torch.no_grad()
def explanation_ratio(
    renderer: FieldsRenderer, rays: PixelRays, sharpness: float, generator: torch.Generator, pixels: int | None = None
) -> float:
    """How much better the object explains the pixels that it covers than F_e alone would if the object were not there: the
    ratio of their mean tone-mapped errors. Near 1: the sphere is empty. 0 where (almost) no pixel is covered.

    pixels: how many random ones that see the sphere are tried; by default the preset's.
    """
    p, environment = renderer.preset, renderer.environment
    pixels = pixels or p.explanation_pixels
    pick = torch.randint(len(rays.sphere), (pixels,), generator=generator, device=generator.device)
    index = rays.sphere[pick]
    bundle = RayBundle(*rays.rays(index))
    surface = renderer.object_field.shape().render(bundle.origins, bundle.directions, sharpness, p.samples, None)
    solid = surface.opacity > p.explanation_opacity
    ray = surface.ray[solid]
    if len(ray) < p.explanation_least_share * pixels:
        return 0.0
    covered = bundle[ray]
    normal = functional.normalize(surface.gradient[solid], dim=-1, eps=1e-6)
    color = renderer.object_field.appearance(surface.point[solid], normal, covered.directions).color
    near = torch.full_like(covered.half_angle, environment.preset.camera_near)
    behind, _ = environment.render(
        covered.origins, covered.directions, near, torch.full_like(near, torch.inf), covered.half_angle, None
    )
    photo = tone_map(rays.photo(index[ray]))
    error = (tone_map(color) - photo).abs().mean().clamp(min=1e-6)  # photos of nothing but black have no error
    return float((tone_map(behind) - photo).abs().mean() / error)


def require_object(ratio: float, least: float) -> None:
    """Raises LearningError where the explanation ratio says that the sphere is empty."""
    if ratio < least:
        raise LearningError(
            f"The object's sphere seems to contain nothing: the surroundings explain its pixels almost as well as an object"
            f" does (ratio {ratio:.2f}, needed {least}).",
            "Set object_center and object_radius in transforms.json so that the sphere holds the object closely.",
        )
