"""The colors of the support plane in the object's sphere, found where the photos agree on them.

F_e knows nothing of what lies in the object's sphere. So without these colors, a table looks like a part of the object in
every photo, and the visual hull gets a mound beside its foot. A point of the plane that photos see has one color in all of
them, up to gloss. A point that the object hides has the object's colors, which mostly differ from photo to photo, or another
chromaticity than the table beside the object.

A part of the photos does not count for a point: those in which the inner part of the shape that is known so far hides it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from blender_nep.capture.pixel_rays import PixelRays
from blender_nep.fields.rendering import RayBundle
from blender_nep.fields.support_search import SmallPhotos, ring
from blender_nep.geometry.support import Support
from blender_nep.profiling import profiled
from blender_nep.tone_mapping import inverse_tone_map

AGREES = 0.04
"""Tone-mapped difference up to which two photos agree on a color."""
LEAST_SHARE = 0.4
"""A color is known if this share of the photos that count agree on it."""
LEAST_VIEWS = 6
"""And if at least this many photos count."""
CORE = 0.05
"""What lies deeper than this in the shape that is known so far hides the plane, in object radii. The rest may be a mound
that is not there."""
CHROMATICITY = 0.06
"""Largest difference between the chromaticity of a known color and that of the plane beside the object. An object of one
plain color would otherwise be taken for the plane that it hides."""
BRIGHTER = 1.5
"""A known color is at most so many times brighter than the plane beside the object. It may be darker: shadows."""
_TEXELS = 84
_BESIDE, _BESIDE_POINTS = 0.5, 400
"""Width of the ring beside the object's sphere in which the plane's chromaticities are found, and number of its points."""
_LEAST_BESIDE = 20
"""Smallest number of points of that ring with a known color."""
_FIRST, _LAST, _STEPS = 0.03, 1.9, 48
"""Whether the shape hides a point is asked at so many distances, between these, on the way to the camera."""
_CHUNK = 512


class SupportTexture:
    """The plane's colors: a square of [n, n] texels that spans [-1, 1]^2 along the support's axes."""

    def __init__(self, support: Support, color: Tensor, known: Tensor) -> None:
        """color [n, n, 3]: linear radiance; known [n, n] bool. Both are on one device."""
        self.support, self.color, self.known = support, color, known

    @classmethod
    @profiled("support texture")
    @torch.no_grad()
    def of(cls, rays: PixelRays, support: Support, sdf: np.ndarray) -> SupportTexture:
        """The colors on which the photos agree. Takes about a CPU second.

        sdf [n, n, n]: the object's shape as it is known so far, at the centres of n^3 cells of [-1, 1]^3, negative inside.
        """
        photos, device = SmallPhotos(rays), rays.radiance.device
        axis = (np.arange(_TEXELS) + 0.5) / _TEXELS * 2 - 1
        across, along = support.axes()
        square = axis[:, None, None] * across + axis[None, :, None] * along + support.height * np.asarray(support.normal)
        points = torch.from_numpy(square.reshape(-1, 3).astype(np.float32)).to(device)
        inside = points.norm(dim=-1) < 1
        color, share, count = _agreement(photos, points[inside], torch.from_numpy(sdf).to(device))
        found = (share > LEAST_SHARE) & (count >= LEAST_VIEWS)
        found &= _like_the_plane(color, _beside(photos, support, device))
        known = torch.zeros(len(points), dtype=torch.bool, device=device)
        known[inside] = found
        colors = torch.zeros(len(points), 3, device=device)
        colors[inside] = color
        return cls(support, colors.reshape(_TEXELS, _TEXELS, 3), known.reshape(_TEXELS, _TEXELS))

    def before(self, background: Callable[[RayBundle], Tensor]) -> Callable[[RayBundle], Tensor]:
        """The background (its radiance [n, 3] for rays [n]) with the known part of the plane before it."""
        return lambda rays: self.shown(rays, background(rays))

    def shown(self, rays: RayBundle, radiance: Tensor) -> Tensor:
        """The radiance [n, 3] of rays [n], where those that meet a known texel show its color instead of `radiance`."""
        normal, across, along = (
            torch.as_tensor(np.asarray(axis), dtype=radiance.dtype, device=radiance.device)
            for axis in (self.support.normal, *self.support.axes())
        )
        cosine = rays.directions @ normal
        t = (self.support.height - rays.origins @ normal) / cosine.clamp(max=-1e-6)
        points = rays.origins + t[:, None] * rays.directions
        place = torch.stack([points @ along, points @ across], -1)[None, :, None]
        texels = torch.cat([self.color, self.known[..., None].to(self.color.dtype)], -1).permute(2, 0, 1)[None]
        found = functional.grid_sample(texels, place, align_corners=False)[0, :, :, 0].T
        use = (found[:, 3] > 0.99) & (cosine < -1e-6) & (t > 0) & (points.norm(dim=-1) < 1)
        return torch.where(use[:, None], found[:, :3], radiance)


def _agreement(photos: SmallPhotos, points: Tensor, sdf: Tensor | None) -> tuple[Tensor, Tensor, Tensor]:
    """For points [n, 3]: the linear color [n, 3] on which most photos agree, their share [n], and the photos [n] that count.

    sdf: photos in which its core hides a point do not count; None: all count.
    """
    found = []
    cameras = [photos.rays.camera(view)[0].to(points) for view in photos.views]
    for part in points.split(_CHUNK):
        seen = photos.colors(part).transpose(0, 1)
        counts = torch.isfinite(seen[..., 0])
        if sdf is not None:
            counts &= ~torch.stack([_hidden(part, camera, sdf) for camera in cameras], 1)
        alike = (seen[:, :, None] - seen[:, None]).abs().mean(-1) < AGREES
        alike &= counts[:, :, None] & counts[:, None]
        most, best = alike.sum(2).max(1)
        chosen = alike[torch.arange(len(part), device=part.device), best]
        color = torch.where(chosen[..., None], seen, 0.0).sum(1) / most.clamp_min(1)[:, None]
        count = counts.sum(1)
        found.append((inverse_tone_map(color), most / count.clamp_min(1), count))
    color, share, count = (torch.cat(values) for values in zip(*found, strict=True))
    return color, share, count


def _hidden(points: Tensor, camera: Tensor, sdf: Tensor) -> Tensor:
    """Whether the core of the shape hides each point [n, 3] from the camera [3]: [n] bool."""
    way = torch.linspace(_FIRST, _LAST, _STEPS, device=points.device)
    between = points[:, None] + way[:, None] * functional.normalize(camera - points, dim=-1)[:, None]
    place = between.flip(-1).reshape(1, 1, 1, -1, 3)
    depth = functional.grid_sample(sdf[None, None], place, align_corners=False, padding_mode="border")
    return (depth.reshape(between.shape[:-1]) < -CORE).any(1)


def _beside(photos: SmallPhotos, support: Support, device: torch.device) -> Tensor:
    """Known colors [m, 3] of the plane in a ring beside the object's sphere."""
    points = torch.from_numpy(ring(support, support.radius, _BESIDE, _BESIDE_POINTS).astype(np.float32)).to(device)
    color, share, count = _agreement(photos, points, None)
    return color[(share > LEAST_SHARE) & (count >= LEAST_VIEWS)]


def _like_the_plane(color: Tensor, beside: Tensor) -> Tensor:
    """Whether colors [n, 3] may be colors of a plane that has the colors [m, 3] beside the object: [n] bool."""
    if len(beside) < _LEAST_BESIDE:
        return torch.zeros(len(color), dtype=torch.bool, device=color.device)
    hue, brightness = _chromaticity(color)
    hues, brightnesses = _chromaticity(beside)
    alike = (hue[:, None] - hues).abs().amax(-1) < CHROMATICITY
    return (alike & (brightness[:, None] < BRIGHTER * brightnesses)).any(1)


def _chromaticity(color: Tensor) -> tuple[Tensor, Tensor]:
    """Chromaticity [n, 3] and sum of the channels [n] of linear colors [n, 3]."""
    brightness = color.sum(-1)
    return color / brightness.clamp_min(1e-6)[:, None], brightness
