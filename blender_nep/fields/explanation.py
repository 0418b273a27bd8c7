"""Checks whether the object's sphere contains an object at all."""

from __future__ import annotations

import torch
from torch.nn import functional

from blender_nep.capture.rays.pixel_rays import PixelRays
from blender_nep.errors import LearningError
from blender_nep.fields.rendering import FieldsRenderer
from blender_nep.tone_mapping import tone_map


@torch.no_grad()
def explanation_ratio(
    renderer: FieldsRenderer, rays: PixelRays, sharpness: float, generator: torch.Generator, pixels: int | None = None
) -> float:
    """The error of F_e alone divided by the error of the object, on pixels that the object covers.

    Both are mean tone-mapped errors. F_e alone is rendered as if the object were not there. Near 1, the sphere is empty. The
    ratio is 0 if hardly any pixel is covered. `pixels` is the number of random pixels whose rays meet the sphere; None: the
    preset's.
    """
    p, environment = renderer.preset, renderer.environment
    pixels = pixels or p.explanation_pixels
    pick = torch.randint(len(rays.sphere), (pixels,), generator=generator, device=generator.device)
    index = rays.sphere[pick]
    bundle = rays.rays(index)
    surface = renderer.object_field.shape().render(bundle.origins, bundle.directions, sharpness, p.samples, None)
    solid = surface.opacity > p.explanation_opacity
    ray = surface.ray[solid]
    if len(ray) < p.explanation_least_share * pixels:
        return 0.0
    covered = bundle[ray]
    normal = functional.normalize(surface.gradient[solid], dim=-1, eps=1e-6)
    color = renderer.object_field.appearance(surface.point[solid], normal, covered.directions, covered.motion).color
    near = torch.full_like(covered.half_angle, environment.preset.camera_near)
    infinity = torch.full_like(near, torch.inf)
    origins, directions, half_angle = covered.in_room()
    behind = environment.render(origins, directions, near, infinity, half_angle, None).radiance
    photo = tone_map(rays.photo(index[ray]))
    error = (tone_map(color) - photo).abs().mean().clamp(min=1e-6)  # the error of entirely black photos may be 0
    return float((tone_map(behind) - photo).abs().mean() / error)


def require_object(ratio: float, least: float) -> None:
    """Raises LearningError if the explanation ratio is below `least`: then the sphere is empty."""
    if ratio >= least:
        return
    found = f"the surroundings explain its pixels almost as well as an object does (ratio {ratio:.2f}, needed {least})"
    if ratio == 0:
        found = "hardly any pixel shows an opaque surface in it"
    raise LearningError(
        f"The object's sphere seems to contain nothing: {found}.",
        "Set object_center and object_radius in transforms.json so that the sphere holds the object closely.",
    )
