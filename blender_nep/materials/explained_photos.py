"""Scores how well a finished asset explains its photos, and F_e the surroundings in them (`asset.photo_score`).

The asset is its mesh and its textures. Its pixels are computed by the rendering equation in all of the light that was found:
F_e, the support plane, the light that no photo shows, and the object itself. So an asset whose surroundings are near is not
blamed for the environment map, which is the light of one point. Where shape, materials and light do not explain the photos
together, one of them is wrong.

Without photos that were held out, the pixels are those that stage 1 held out. So the score costs no photo. Stage 2 may have
learned from a few of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
import trimesh
from torch import Tensor, nn

from blender_nep.asset.photo_score import PhotoScore, photo_score
from blender_nep.capture.rays.pixel_rays import PixelRays
from blender_nep.capture.rays.pixel_set import PixelSet
from blender_nep.capture.rays.response_curve import ResponseCurve
from blender_nep.fields.environment.field import EnvironmentField
from blender_nep.fields.object_pixels import held_out
from blender_nep.geometry.mesh import Surface
from blender_nep.geometry.uv_raster import look_up
from blender_nep.materials.samples.photo_samples import beside_surface, edges_and_reflection_variance
from blender_nep.profiling import profiled
from blender_nep.shading import brdf
from blender_nep.shading.cones import diffuse_cones, specular_cones
from blender_nep.shading.photographer import Photographer
from blender_nep.shading.plenoptic import (
    Material,
    PlenopticFunction,
    PlenopticSettings,
    SpecularMoments,
    SurfacePoints,
    TerminalRadiance,
    local,
    moment_weights,
    reflected,
)
from blender_nep.support.plane import Support

_PIXELS = 1500
"""Most pixels of the object that are scored, and most of the surroundings. More hardly change a score."""
_TRIED = 5
"""So many times as many pixels are tried: the object may cover a small part of its sphere."""
_SPECULAR, _DIFFUSE = 64, 64
"""Cones of the two lobes at a point that a pixel shows. With 8 and 16, small windows in a rough lobe made the asset noisy:
the score of a real brass blowtorch was 0.8 dB and 0.5 degrees worse than without noise."""
OF_HITS = PlenopticSettings(levels=2, diffuse=6, specular=2)
"""Cones at a point that the object mirrors in itself. What such a point reflects of the object is left out."""
_OBJECT, _BESIDE = 250, 5
"""A pixel shows the object if its mask is at least the first, and the surroundings if it is at most the second, of 255."""


class NoRadiance(TerminalRadiance):
    """A terminal radiance of 0: light that the object has reflected more than twice is left out."""

    def __init__(self) -> None:
        nn.Module.__init__(self)

    def forward(self, points: SurfacePoints) -> Tensor:
        return torch.zeros_like(points.position)


@dataclass(frozen=True)
class TexturedSurface:
    """The mesh of an asset with its textures."""

    surface: Surface
    textures: dict[str, np.ndarray]
    """albedo [S, S, 3], roughness and metallic [S, S]"""

    def materials_at(self, points: SurfacePoints) -> Material:
        """The material of surface points, as the textures say."""
        corners = np.asarray(self.surface.faces)[points.face]
        place = points.position.cpu().numpy().astype(np.float64)
        weights = trimesh.triangles.points_to_barycentric(np.asarray(self.surface.vertices)[corners], place)
        uv = (self.surface.atlas[corners] * np.clip(weights, 0, 1)[..., None]).sum(1)
        albedo, roughness, metallic = (
            torch.from_numpy(look_up(self.textures[name], uv).astype(np.float32)).to(points.position.device)
            for name in ("albedo", "roughness", "metallic")
        )
        return Material(albedo, roughness[:, 0], metallic[:, 0])


@dataclass(frozen=True)
class Explained:
    """How well the photos are explained."""

    object: PhotoScore | None
    """The pixels of the object. None: too few pixels show it"""
    surroundings: PhotoScore | None
    """The pixels beside it. None: the photos show too little beside it, or are cut-outs"""


@profiled("explained photos")
@torch.no_grad()
def explain_photos(
    asset: TexturedSurface,
    f_p: PlenopticFunction,
    environment: EnvironmentField,
    rays: PixelRays,
    every: int,
    own_gains: bool,
    seed: int,
    response: ResponseCurve | None = None,
    object_gain: Tensor | None = None,
    photographer: Photographer | None = None,
) -> Explained:
    """Score one of `every` pixels of the photos, at most _PIXELS of the object and as many beside it.

    f_p is that of the asset's mesh in the light that was found, with `OF_HITS` and `NoRadiance`; `environment` is F_e. With
    `own_gains`, each photo has a gain of its own. Without, all have one, because their exposures are evened out.

    `response` is the camera's response curve, which photos and F_e have, and the asset has not. None: there is none.
    object_gain [views]: how much brighter the object is in each photo than in the others. None: it is as bright in all.
    `photographer` takes light from the object. None: nobody does.
    """
    random = np.random.default_rng(seed)
    index = _drawn(rays.sphere, every, _TRIED * _PIXELS, random)
    bundle = rays.rays(index)
    origins, directions, half_angle = (x.cpu().numpy() for x in bundle)
    distance, face, barycentric = f_p.tracer.intersect(origins, directions)
    hit = np.isfinite(distance)
    if rays.mask is None:
        of_object, beside = hit, ~hit
    else:
        mask = rays.mask[index].cpu().numpy()
        of_object, beside = mask >= _OBJECT, ~hit & (mask <= _BESIDE)
    burnt = rays.burnt_out(index).cpu().numpy()
    of_object = of_object & ~burnt
    beside = beside & ~burnt & ~_support_shown(f_p, origins, directions)
    chosen = np.flatnonzero(of_object)
    if len(chosen) > _PIXELS:
        chosen = np.sort(random.choice(chosen, _PIXELS, replace=False))
    normals = f_p.tracer.smooth_normals(f_p.normals, np.maximum(face, 0), barycentric)
    cosine = np.maximum(np.abs(np.einsum("ij,ij->i", f_p.tracer.face_normals[np.maximum(face, 0)], directions)), 0.05)
    edge, variance = edges_and_reflection_variance(
        f_p.tracer, f_p.normals, origins, directions, distance, half_angle, normals, cosine, _flags(chosen, hit)
    )
    missing = chosen[~hit[chosen]]
    edge[missing] = beside_surface(f_p.tracer, origins[missing], directions[missing], half_angle[missing])
    chosen = chosen[~edge[chosen]]  # a pixel at an edge mixes what is on both sides
    seen = chosen[hit[chosen]]
    generator = torch.Generator().manual_seed(seed)
    device = index.device
    of_asset = np.zeros((len(index), 3), np.float32)
    shown = torch.from_numpy(seen).to(device)
    points = f_p.points(face[seen], barycentric[seen], -bundle.directions[shown], bundle.motion_of(shown))
    light = _radiance(asset, f_p, points, torch.from_numpy(variance[seen]).float().to(device), generator, photographer)
    of_asset[seen] = (light if response is None else response.photo(light)).cpu()
    missed = chosen[~hit[chosen]]
    of_asset[missed] = behind(environment, rays, index[torch.from_numpy(missed).to(device)])
    at = torch.from_numpy(chosen).to(device)
    scored = index[at]
    compared = _in_files(rays, _equally_bright(rays, scored, object_gain, response), of_asset[chosen])
    found = photo_score(*compared, _numbers(rays, scored, own_gains))
    in_sphere = index[torch.from_numpy(beside).to(device)]
    return Explained(found, _surroundings(environment, rays, in_sphere, every, own_gains, random))


def _numbers(rays: PixelRays, index: Tensor, own_gains: bool) -> np.ndarray:
    """The numbers [n] int of the photos that show the pixels index [n]; without `own_gains`, all are taken for one photo."""
    return rays.view_of(index).cpu().numpy() if own_gains else np.zeros(len(index), np.int64)


def _surroundings(
    environment: EnvironmentField, rays: PixelRays, beside: Tensor, every: int, own_gains: bool, random: np.random.Generator
) -> PhotoScore | None:
    """The score of F_e on pixels whose rays miss the sphere, and on the pixels `beside` the object in it."""
    if not (rays.background and environment.known):
        return None
    outside = _drawn(rays.outside, every, _PIXELS, random)
    index = torch.cat([outside[~rays.burnt_out(outside)], beside]).sort().values
    if len(index) > _PIXELS:
        index = index[torch.from_numpy(np.sort(random.choice(len(index), _PIXELS, replace=False))).to(index.device)]
    compared = _in_files(rays, rays.photo(index), behind(environment, rays, index))
    return photo_score(*compared, _numbers(rays, index, own_gains))


def _equally_bright(rays: PixelRays, index: Tensor, gain: Tensor | None, response: ResponseCurve | None) -> Tensor:
    """The radiance [n, 3] of the object's pixels index [n], as if the object was as bright in all photos.

    gain [views] is that of the object's light (`photo_gains`), before the camera's curve `response`.
    """
    if gain is None or response is None:
        return rays.with_object_gain(gain).photo(index)
    return response.photo(rays.with_response(response).with_object_gain(gain).photo(index))


def _in_files(rays: PixelRays, shown: Tensor, radiance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What files of one exposure have of `shown` [n, 3] and `radiance` [n, 3], both as `PixelRays.photo` gives them."""
    both = shown, torch.from_numpy(np.asarray(radiance, np.float32)).to(shown.device)
    found, predicted = (rays.as_in_files(values).cpu().numpy() for values in both)
    return found, predicted


def _drawn(pixels: PixelSet, every: int, most: int, random: np.random.Generator) -> Tensor:
    """At most `most` random pixels [m] int64, in rising order, among those of which one of `every` is held out."""
    parts = [part[held_out(part, every)] for part in pixels.split(1 << 20)]
    index = torch.cat(parts) if parts else pixels.tensor()
    if len(index) > most:
        index = index[torch.from_numpy(np.sort(random.choice(len(index), most, replace=False))).to(index.device)]
    return index


def _flags(chosen: np.ndarray, hit: np.ndarray) -> np.ndarray:
    """Which of the pixels [n] are chosen and hit the mesh: [n] bool."""
    flags = np.zeros(len(hit), bool)
    flags[chosen] = True
    return flags & hit


def _support_shown(f_p: PlenopticFunction, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    light = f_p.support_light
    return np.zeros(len(origins), bool) if light is None else shows_support(light.texture.support, origins, directions)


def shows_support(support: Support, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Whether rays [n] meet the support plane inside the unit sphere, where F_e does not know it: [n] bool."""
    t = -support.distance(origins) / (directions @ np.asarray(support.normal))
    at = origins + t[:, None] * directions
    return (t > 0) & (np.square(at).sum(1) < 1)


def behind(environment: EnvironmentField, rays: PixelRays, index: Tensor) -> np.ndarray:
    """The radiance [n, 3] of F_e in the pixels index [n], as if the object were not there."""
    origins, directions, half_angle = rays.rays(index).in_room()
    near = torch.full_like(half_angle, environment.preset.camera_near)
    shown = environment.render(origins, directions, near, torch.full_like(near, torch.inf), half_angle)
    return shown.radiance.detach().cpu().numpy()


def _radiance(
    asset: TexturedSurface,
    f_p: PlenopticFunction,
    points: SurfacePoints,
    variance: Tensor,
    generator: torch.Generator,
    photographer: Photographer | None,
) -> Tensor:
    """Radiance [n, 3] that the asset sends to the eye at n points.

    variance [n] radians^2 is that of the mirrored direction within a pixel. It widens the specular cones.
    """
    n, device = len(points), points.position.device
    material, frame = asset.materials_at(points), brdf.frame(points.normal)
    v = local(frame, points.view)
    turn = torch.rand(n, 2, 2, generator=generator).to(device)
    specular, weight, cos_vh, angle = specular_cones(v, material.roughness, _SPECULAR, turn[:, 0])
    angle = (angle**2 + 4 * variance[:, None]).sqrt()  # a disc of half angle a has the variance a^2 / 4 along each axis
    diffuse, wide = diffuse_cones(_DIFFUSE, turn[:, 1])
    directions = torch.einsum("nij,nkj->nki", frame, torch.cat([specular, diffuse], 1)).reshape(-1, 3)
    each = torch.arange(n, device=device).repeat_interleave(_SPECULAR + _DIFFUSE)
    half_angle = torch.cat([angle, wide], 1).reshape(-1)
    light = f_p.incoming(points[each], directions, half_angle, asset.materials_at, 1, generator)
    if photographer is not None:
        light = light * photographer.left(directions, points.view[each])[:, None]
    light = light.reshape(n, _SPECULAR + _DIFFUSE, 3)
    mirrored, irradiance = light[:, :_SPECULAR], light[:, _SPECULAR:].mean(1)
    moments = SpecularMoments(*((w[..., None] * mirrored).sum(1) for w in moment_weights(weight, cos_vh)))
    return reflected(material, moments, irradiance, v[:, 2])
