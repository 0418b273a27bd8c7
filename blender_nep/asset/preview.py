"""Renders the preview picture of the asset: a photo beside the same view of the asset in its own light.

The rendering is simple: distant light without shadows, prefiltered by roughness. It does not measure the asset's quality.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch

from blender_nep.capture.rays.response_curve import ResponseCurve
from blender_nep.color import linear_to_srgb, to_bytes
from blender_nep.geometry.ray_tracing import RayTracer
from blender_nep.geometry.uv_raster import look_up
from blender_nep.safety.arrays import check_array

if TYPE_CHECKING:
    from blender_nep.capture import PixelRays
    from blender_nep.geometry.mesh import Surface

RAYS_ACROSS = 2
"""A pixel of the picture is the mean of RAYS_ACROSS^2 rays. With one ray, the relief of embossed metal glitters."""


@dataclass
class PreviewView:
    """The view of the preview picture: what one photo shows, and where its pixels look, without the other photos."""

    photo: np.ndarray
    """[h, w, 3] linear radiance"""
    origin: np.ndarray
    """[3] the camera's place in the unit frame"""
    directions: np.ndarray
    """[h w, 3] unit vectors"""
    response: dict[str, float] | None = None
    """The camera's response curve (`ResponseCurve.state`), which the photo has and the asset has not"""
    to_room: np.ndarray | None = None
    """[3, 3] the rotation from the object's frame to the room's, where the light stands; None if the object stood still"""

    def check(self) -> None:
        """Raises ValueError unless the arrays fit each other."""
        check_array("photo", self.photo, (None, None, 3))
        check_array("origin", self.origin, (3,))
        check_array("directions", self.directions, (self.photo.shape[0] * self.photo.shape[1], 3))
        if self.response is not None:
            ResponseCurve.from_state(self.response)
        if self.to_room is not None:
            check_array("to_room", self.to_room, (3, 3))

    @classmethod
    def best(cls, rays: PixelRays, surface: Surface, response: ResponseCurve | None = None) -> PreviewView:
        """The photo that `best_view` chooses. `response` is the curve that the photos have."""
        view = best_view(rays, RayTracer(surface.vertices, surface.faces))
        index = torch.arange(rays.offset[view], rays.offset[view + 1], device=rays.valid.device)
        origins, directions, _ = (t.cpu().numpy() for t in rays.rays(index))
        photo = rays.photo(index).cpu().numpy().reshape(*rays.size[view], 3)
        curve = None if response is None else response.state()
        to_room = None if rays.turntable is None else rays.turntable.rotation[view].cpu().numpy()
        return cls(photo, origins[0], directions, curve, to_room)

    def render(self, surface: Surface, textures: dict[str, np.ndarray], light: np.ndarray) -> np.ndarray:
        """A picture [h, 2 w, 3] uint8 sRGB: the photo on the left, the asset on the right.

        `textures` are [S, S] or [S, S, 3]; `light` [H, 2H, 3] is linear radiance in the room's frame.
        """
        tracer, lamps = RayTracer(surface.vertices, surface.faces), Pyramid.of(light)
        parts = (self._radiance(directions, tracer, surface, textures, lamps) for directions in self._through_pixels())
        picture = sum(parts, start=np.float32(0)) / RAYS_ACROSS**2
        if self.response is not None:
            picture = ResponseCurve.from_state(self.response).photo(torch.from_numpy(picture)).numpy()
        pair = np.concatenate([self.photo, picture.reshape(self.photo.shape)], 1) * exposure(self.photo)
        return to_bytes(linear_to_srgb(pair))

    def _through_pixels(self) -> Iterator[np.ndarray]:
        """Unit directions [h w, 3] through RAYS_ACROSS^2 places of each pixel: one place of all pixels at a time."""
        middle = self.directions.reshape(self.photo.shape)
        # a photo of one row or column has no neighbors to take the step from
        down, across = (np.gradient(middle, axis=i) if middle.shape[i] > 1 else np.zeros_like(middle) for i in (0, 1))
        for y, x in itertools.product((np.arange(RAYS_ACROSS) + 0.5) / RAYS_ACROSS - 0.5, repeat=2):
            directions = middle + y * down + x * across
            yield (directions / np.linalg.norm(directions, axis=-1, keepdims=True)).reshape(-1, 3)

    def _radiance(
        self,
        directions: np.ndarray,
        tracer: RayTracer,
        surface: Surface,
        textures: dict[str, np.ndarray],
        lamps: Pyramid,
    ) -> np.ndarray:
        """Radiance [n, 3] that the camera sees in unit directions [n, 3]: the asset in front of its light."""
        distance, face, barycentric = tracer.intersect(np.broadcast_to(self.origin, directions.shape), directions)
        hit = np.flatnonzero(np.isfinite(distance))
        radiance = lamps.lookup(self._in_room(directions), np.zeros(len(directions)))
        if len(hit):
            corners = np.asarray(surface.faces)[face[hit]]
            weights = barycentric[hit][..., None]
            normal = (np.asarray(surface.normals)[corners] * weights).sum(1)
            normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)
            uv = (surface.atlas[corners] * weights).sum(1)
            material = {k: look_up(t, uv) for k, t in textures.items()}
            radiance[hit] = shade(self._in_room(normal), -self._in_room(directions[hit]), material, lamps)
        return radiance

    def _in_room(self, directions: np.ndarray) -> np.ndarray:
        """Directions [n, 3] of the object's frame in the room's."""
        return directions if self.to_room is None else directions @ self.to_room.T


def exposure(photo: np.ndarray) -> float:
    """The factor that brings a photo [..., 3] of linear radiance into 0..1, so that only few highlights are clipped."""
    return min(0.8 / max(float(np.quantile(photo.max(-1), 0.97)), 1e-6), 100.0)


def best_view(rays: PixelRays, tracer: RayTracer) -> int:
    """Index of the photo for the picture.

    It is chosen from the better half of the photos: they show much of the object and do not cut it at the border. Among
    them it is the one whose camera is nearest to 20 degrees above the object.
    """
    score, height_off = [], []
    for view in range(rays.views):
        height, width = rays.size[view]
        step = max(1, min(height, width) // 32)
        grid = np.arange(height * width).reshape(height, width)[::step, ::step]
        index = torch.from_numpy(grid.ravel() + rays.offset[view]).to(rays.valid.device)
        origins, directions, _ = (t.cpu().numpy() for t in rays.rays(index))
        hit = np.isfinite(tracer.intersect(origins, directions)[0]).reshape(grid.shape)
        border = hit[0].sum() + hit[-1].sum() + hit[:, 0].sum() + hit[:, -1].sum()
        usable = float(rays.valid[index].float().mean())
        score.append(usable * (hit.sum() - 5.0 * border) / hit.size)
        height_off.append(abs(origins[0, 2] / np.linalg.norm(origins[0]) - math.sin(math.radians(20))))
    good = np.array(score) >= np.quantile(score, 0.5)
    return int(np.argmin(np.where(good, height_off, np.inf)))


def shade(normal: np.ndarray, to_eye: np.ndarray, material: dict[str, np.ndarray], light: Pyramid) -> np.ndarray:
    """Radiance [n, 3] of n points in distant light, by split-sum shading (Karis 2013; analytic BRDF fit: Karis 2014).

    normal, to_eye [n, 3] are unit vectors; `material` has albedo [n, 3], roughness and metallic [n, 1].
    """
    albedo, roughness, metallic = material["albedo"], material["roughness"], material["metallic"]
    cosine = np.clip((normal * to_eye).sum(-1, keepdims=True), 1e-3, 1)
    mirror = 2 * cosine * normal - to_eye
    a004 = np.minimum((1 - roughness) ** 2, 2 ** (-9.28 * cosine)) * (1 - roughness) + 0.0425 - 0.0275 * roughness
    scale, bias = -1.04 * a004 + 1.04 - 0.572 * roughness, 1.04 * a004 - 0.04 + 0.022 * roughness
    f0 = 0.04 * (1 - metallic) + metallic * albedo
    specular = (f0 * np.clip(scale, 0, 1) + np.clip(bias, 0, 1)) * light.lookup(mirror, roughness[:, 0])
    return albedo * (1 - metallic) * light.irradiance(normal) / math.pi + specular


@dataclass
class Pyramid:
    """An equirectangular light [h, 2h, 3] at several resolutions, each half of the one before.

    It has Blender's World orientation, z up.
    """

    levels: list[np.ndarray]

    @classmethod
    def of(cls, light: np.ndarray) -> Pyramid:
        """All levels of `light`, down to 4 to 7 rows. Each level is the level before, box-filtered."""
        levels = [np.asarray(light, np.float32)]
        while levels[-1].shape[0] >= 8:
            last = levels[-1][: levels[-1].shape[0] // 2 * 2, : levels[-1].shape[1] // 2 * 2]
            levels.append((last[::2, ::2] + last[1::2, ::2] + last[::2, 1::2] + last[1::2, 1::2]) / 4)
        return cls(levels)

    def lookup(self, direction: np.ndarray, roughness: np.ndarray) -> np.ndarray:
        """Radiance [n, 3] from directions [n, 3], averaged over about the width of the GGX lobe (alpha radians).

        roughness [n] is Principled's.
        """
        texel = math.pi / self.levels[0].shape[0]
        level = np.clip(np.log2(np.maximum(roughness**2 / texel, 1)), 0, len(self.levels) - 1)
        low = np.floor(level).astype(int)
        out = np.zeros((len(direction), 3), np.float32)
        for k in np.unique(np.concatenate([low, np.minimum(low + 1, len(self.levels) - 1)])):
            weight = np.clip(1 - np.abs(level - k), 0, 1)
            used = weight > 0
            out[used] += weight[used, None] * _bilinear(self.levels[k], direction[used])
        return out

    def irradiance(self, normal: np.ndarray) -> np.ndarray:
        """Irradiance [n, 3]: the integral of radiance times cosine over the hemisphere around normals [n, 3]."""
        coarse = min(self.levels, key=lambda level: abs(level.shape[0] - 16))
        height, width = coarse.shape[:2]
        up = math.pi * (0.5 - (np.arange(height) + 0.5) / height)
        around = 2 * math.pi * (0.5 - (np.arange(width) + 0.5) / width)
        area = np.cos(up) * (math.pi / height) * (2 * math.pi / width)
        direction = np.stack(
            [
                np.outer(np.cos(up), np.cos(around)),
                np.outer(np.cos(up), np.sin(around)),
                np.outer(np.sin(up), np.ones(width)),
            ],
            -1,
        ).reshape(-1, 3)
        power = (coarse * area[:, None, None]).reshape(-1, 3)
        return np.concatenate(
            [np.maximum(part @ direction.T, 0) @ power for part in np.array_split(normal, len(normal) // 4096 + 1)]
        )


def _bilinear(image: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Bilinear values [n, 3] of an equirectangular image [h, 2h, 3] in unit directions [n, 3].

    As in Blender, u = 1/2 - atan2(y, x) / 2 pi and v = 1/2 + asin(z) / pi; row 0 is the zenith.
    """
    height, width = image.shape[:2]
    x = (0.5 - np.arctan2(direction[:, 1], direction[:, 0]) / (2 * math.pi)) * width - 0.5
    y = (0.5 - np.arcsin(np.clip(direction[:, 2], -1, 1)) / math.pi) * height - 0.5
    column, row = np.floor(x).astype(int), np.floor(y).astype(int)
    fx, fy = (x - column)[:, None], (y - row)[:, None]

    def at(j: np.ndarray, i: np.ndarray) -> np.ndarray:
        return image[np.clip(j, 0, height - 1), i % width]

    top = at(row, column) * (1 - fx) + at(row, column + 1) * fx
    return top * (1 - fy) + (at(row + 1, column) * (1 - fx) + at(row + 1, column + 1) * fx) * fy
