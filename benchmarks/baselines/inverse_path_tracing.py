"""Learns materials and a distant environment map on a known mesh by inverse path tracing.

The path tracer is Mitsuba 3 with LLVM, and its gradients are those of path replay backpropagation. That is what one would
choose today without a GPU. Nothing of our stage 2 is used.

Importing this file needs the extra `peer` and an LLVM shared library of version 15 or newer (DRJIT_LIBLLVM_PATH); otherwise
it raises ImportError. Textures are [H, W, ...] with row 0 at v = 1, as everywhere. The environment map has Mitsuba's
orientation: row i is at the angle pi i / (rows - 1) from +y, and column j is at (j + 0.5) / columns of a turn from -z
towards +x.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from blender_nep.capture.rays.pixel_rays import PixelRays
from blender_nep.errors import LearningError
from blender_nep.geometry.mesh import Surface
from blender_nep.geometry.ray_tracing import RayTracer
from blender_nep.tone_mapping import tone_map

mi.set_variant("llvm_ad_rgb")

LEAST_ROUGHNESS = 0.04


@dataclass(frozen=True)
class PeerSettings:
    """Settings of the optimization."""

    levels: tuple[int, ...] = (1, 8, 32, 128, 256)
    """Sides, in texels, of the textures that are summed. (1,) gives one material for the whole object."""
    environment_rows: int = 64
    depth: int = 3
    """Segments of a path, counted from the camera: direct light and one reflection in the object."""
    pixels: int = 2048
    """Pixels a step, of all photos together"""
    samples: int = 16
    """Paths a pixel"""
    samples_grad: int = 8
    """Paths a pixel for the gradient. They are other paths, so that the gradient is not correlated with the error."""
    material_rate: float = 0.05
    environment_rate: float = 0.1
    last_rate: float = 0.05
    """Both rates fall geometrically. At the end they are their first value times this number."""
    smoothness: float = 0.05
    """Weight of the textures' total variation"""
    environment_smoothness: float = 0.01
    """Weight of the total variation of the logarithm of the environment map"""
    background: float = 1.0
    """Weight of the photos' background, which keeps the map as photos show it. Each step has as many pixels of the
    background as of the object."""


class _PhotoPixels(mi.Sensor):
    """A sensor whose n pixels have given rays. The film is n x 1, and the samples of a pixel are spread over its cone."""

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.origins, self.directions, self.tangents = mi.Point3f(0), mi.Vector3f(0, 0, 1), mi.Float(0)

    def sample_ray_differential(self, time, sample1, sample2, sample3, active=True):
        count = self.film().crop_size()[0]
        across = sample2.x * count
        pixel = dr.minimum(mi.UInt32(across), count - 1)
        origin = dr.gather(mi.Point3f, self.origins, pixel, active)
        axis = dr.gather(mi.Vector3f, self.directions, pixel, active)
        disk = mi.warp.square_to_uniform_disk_concentric(mi.Point2f(across - mi.Float(pixel), sample2.y))
        disk *= dr.gather(mi.Float, self.tangents, pixel, active)
        direction = dr.normalize(mi.Frame3f(axis).to_world(mi.Vector3f(disk.x, disk.y, 1)))
        return mi.RayDifferential3f(origin, direction, 0.0, []), mi.Color3f(1)


mi.register_sensor("photo_pixels", _PhotoPixels)


class PathTracer:
    """Renders a mesh with a Principled BSDF under an environment map. torch can differentiate the rendering."""

    def __init__(self, surface: Surface, settings: PeerSettings) -> None:
        self.settings = settings
        gray = {"type": "bitmap", "raw": True, "wrap_mode": "clamp"}
        bsdf = mi.load_dict(
            {
                "type": "principled",
                "base_color": gray | {"data": mi.TensorXf(np.full((2, 2, 3), 0.5, np.float32))},
                "roughness": gray | {"data": mi.TensorXf(np.full((2, 2, 1), 0.5, np.float32))},
                "metallic": gray | {"data": mi.TensorXf(np.full((2, 2, 1), 0.5, np.float32))},
            }
        )
        props = mi.Properties()
        props["bsdf"] = bsdf
        mesh = mi.Mesh(
            "object",
            len(surface.vertices),
            len(surface.faces),
            has_vertex_normals=True,
            has_vertex_texcoords=True,
            props=props,
        )
        values = mi.traverse(mesh)
        values["vertex_positions"] = surface.vertices.astype(np.float32).ravel()
        values["vertex_normals"] = surface.normals.astype(np.float32).ravel()
        # The first row of a texture is at v = 0 in Mitsuba, and at v = 1 here.
        values["vertex_texcoords"] = (surface.uv * [1, -1] + [0, 1]).astype(np.float32).ravel()
        values["faces"] = surface.faces.astype(np.uint32).ravel()
        values.update()
        rows = settings.environment_rows
        light = mi.Bitmap(np.ones((rows, 2 * rows, 3), np.float32))
        self.scene = mi.load_dict(
            {
                "type": "scene",
                "object": mesh,
                "light": {"type": "envmap", "bitmap": light},
                "integrator": {"type": "prb", "max_depth": settings.depth},
            }
        )
        self.values = mi.traverse(self.scene)
        part = {
            name: [k for k in self.values.keys() if k.endswith(f"{name}.data")]
            for name in ("base_color", "roughness", "metallic", "light")
        }
        self.keys = [found[0] for found in part.values()]
        self.sensors: dict[int, mi.Sensor] = {}

    def _sensor(self, count: int) -> mi.Sensor:
        if count not in self.sensors:
            self.sensors[count] = mi.load_dict(
                {
                    "type": "photo_pixels",
                    "sampler": {"type": "independent"},
                    "film": {
                        "type": "hdrfilm",
                        "width": count,
                        "height": 1,
                        "pixel_format": "rgb",
                        "component_format": "float32",
                        "rfilter": {"type": "box"},
                    },
                }
            )
        return self.sensors[count]

    def render(
        self,
        albedo: Tensor,
        roughness: Tensor,
        metallic: Tensor,
        environment: Tensor,
        rays: tuple[Tensor, Tensor, Tensor],
        samples: int,
        seed: int,
    ) -> Tensor:
        """Radiance [n, 3] of rays (origins [n, 3], unit directions [n, 3], half angles [n]).

        albedo [H, W, 3], roughness and metallic [H, W], environment [rows, 2 rows, 3].
        """
        origins, directions, half_angle = (x.detach().cpu().float().numpy() for x in rays)
        sensor = self._sensor(len(origins))
        sensor.origins = mi.Point3f(np.ascontiguousarray(origins.T))
        sensor.directions = mi.Vector3f(np.ascontiguousarray(directions.T))
        sensor.tangents = mi.Float(np.tan(half_angle))
        # Mitsuba's map has the last column once more before the first one, and the first one once more after the last one.
        wrapped = torch.cat([environment[:, -1:], environment, environment[:, :1]], 1)

        @dr.wrap(source="torch", target="drjit")
        def traced(*textures):
            for key, texture in zip(self.keys, textures, strict=True):
                self.values[key] = texture
            self.values.update()
            return mi.render(
                self.scene,
                self.values,
                sensor=sensor,
                spp=samples,
                seed=seed,
                spp_grad=self.settings.samples_grad,
                seed_grad=seed + (1 << 30),
            )

        return traced(albedo, roughness[..., None], metallic[..., None], wrapped)[0]


class Textures(nn.Module):
    """The textures of albedo, roughness and metallic.

    Each is a sum of levels, coarse to fine, through a sigmoid. The sigmoid is 0.5 everywhere at the start.
    """

    def __init__(self, levels: tuple[int, ...]) -> None:
        super().__init__()
        self.levels = nn.ParameterList(torch.zeros(1, 5, side, side) for side in levels)

    def forward(self) -> tuple[Tensor, Tensor, Tensor]:
        """(albedo [H, W, 3], roughness [H, W], metallic [H, W])."""
        side = max(self.levels[-1].shape[-1], 2)  # Mitsuba takes no texture of one texel
        total = sum(functional.interpolate(x, (side, side), mode="bilinear") for x in self.levels)
        values = torch.sigmoid(total[0]).permute(1, 2, 0)
        return values[..., :3], LEAST_ROUGHNESS + (1 - LEAST_ROUGHNESS) * values[..., 3], values[..., 4]


def object_and_background(rays: PixelRays, surface: Surface) -> tuple[Tensor, Tensor]:
    """(indices of the object's pixels, indices of the background's pixels). All of them are valid pixels.

    A pixel belongs to the object where the pixel and its four neighbors show the mesh. It belongs to the background where
    none of the five shows the mesh.
    """
    tracer = RayTracer(surface.vertices, surface.faces)
    hit = torch.zeros(rays.count, dtype=torch.bool)
    sphere = rays.sphere.tensor()
    origins, directions, _ = rays.rays(sphere)
    hit[sphere] = torch.from_numpy(tracer.occluded(origins.numpy(), directions.numpy()))
    inner, near = hit.clone(), hit.clone()
    for view, (height, width) in enumerate(rays.size):
        part = slice(rays.offset[view], rays.offset[view + 1])
        shown = functional.pad(hit[part].reshape(1, 1, height, width).float(), (1, 1, 1, 1))[0, 0]
        around = torch.stack([shown[1:-1, :-2], shown[1:-1, 2:], shown[:-2, 1:-1], shown[2:, 1:-1]])
        inner[part] &= (around.amin(0) > 0).flatten()
        near[part] |= (around.amax(0) > 0).flatten()
    return (inner & rays.valid).nonzero()[:, 0], (~near & rays.valid).nonzero()[:, 0]


def texel_of(directions: Tensor, rows: int) -> Tensor:
    """Indices [n], into the flattened environment map, of the texels that unit directions [n, 3] meet."""
    x, y, z = directions.unbind(-1)
    row = (torch.acos(y.clamp(-1, 1)) / math.pi * (rows - 1)).round().long()
    column = (torch.atan2(x, -z) / (2 * math.pi) * 2 * rows).floor().long() % (2 * rows)
    return row * 2 * rows + column


def photographed_environment(rays: PixelRays, background: Tensor, rows: int) -> Tensor:
    """An environment map [rows, 2 rows, 3] of what the photos' background shows, as if it were infinitely far away.

    Where no photo shows a direction, the map has the geometric mean of the rest.
    """
    total, count = torch.zeros(rows * 2 * rows, 3), torch.zeros(rows * 2 * rows, 1)
    for index in background.split(1 << 18):
        texel = texel_of(rays.rays(index).directions, rows)
        total.index_add_(0, texel, rays.radiance[index].float())
        count.index_add_(0, texel, torch.ones(len(index), 1))
    mean = total / count.clamp(min=1)
    usual = mean[count[:, 0] > 0].clamp(min=1e-3).log().mean(0).exp()
    return torch.where(count > 0, mean, usual).reshape(rows, 2 * rows, 3)


@dataclass
class Learned:
    """The textures and the light that were learned, and a report of the optimization."""

    albedo: np.ndarray
    roughness: np.ndarray
    metallic: np.ndarray
    environment: np.ndarray
    report: dict


def _variation(texture: Tensor) -> Tensor:
    """The total variation of a texture [H, W, C].

    It is the mean absolute difference of texels that are neighbors in a column, plus that of neighbors in a row.
    """
    return texture.diff(dim=0).abs().mean() + texture.diff(dim=1).abs().mean()


def learn(surface: Surface, rays: PixelRays, settings: PeerSettings, minutes: float, seed: int) -> Learned:
    """Learn the textures and the light for `minutes` minutes of CPU time.

    Adam takes steps on random pixels of all photos, of the object and of the background. The loss is the mean absolute
    difference in tone-mapped space. The reported loss is that of the object's pixels alone. Raises LearningError for
    cut-outs.
    """
    start = time.process_time()
    torch.manual_seed(seed)
    inside, background = object_and_background(rays, surface)
    if not (rays.background and len(background)):
        raise LearningError("the photos show no background, which the peer's light starts from", "give whole photos")
    textures = Textures(settings.levels)
    seen = photographed_environment(rays, background, settings.environment_rows)
    light = nn.Parameter(seen.clamp(min=1e-3).log())
    optimizer = torch.optim.Adam(
        [
            {"params": textures.parameters(), "lr": settings.material_rate},
            {"params": [light], "lr": settings.environment_rate},
        ],
        betas=(0.9, 0.99),
    )
    rates = [group["lr"] for group in optimizer.param_groups]
    tracer = PathTracer(surface, settings)
    step, losses, fraction = 0, [], 0.0
    while fraction < 1:
        for group, rate in zip(optimizer.param_groups, rates, strict=True):
            group["lr"] = rate * settings.last_rate**fraction
        index = inside[torch.randint(len(inside), (settings.pixels,))]
        maps = textures()
        radiance = tracer.render(*maps, light.exp(), rays.rays(index), settings.samples, seed=step)
        loss = (tone_map(radiance) - tone_map(rays.radiance[index].float())).abs().mean()
        losses.append(float(loss.detach()))
        if settings.background > 0:
            behind = background[torch.randint(len(background), (settings.pixels,))]
            shown = light.exp().flatten(0, 1)[texel_of(rays.rays(behind).directions, settings.environment_rows)]
            loss = loss + settings.background * (tone_map(shown) - tone_map(rays.radiance[behind].float())).abs().mean()
        stacked = torch.cat([maps[0], maps[1][..., None], maps[2][..., None]], -1)
        loss = loss + settings.smoothness * _variation(stacked) + settings.environment_smoothness * _variation(light)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        step += 1
        fraction = (time.process_time() - start) / (60 * minutes)
    with torch.no_grad():
        maps = [x.numpy() for x in textures()]
    report = {
        "steps": step,
        "object_pixels": len(inside),
        "first_loss": float(np.mean(losses[:10])),
        "last_loss": float(np.mean(losses[-50:])),
    }
    return Learned(*maps, light.detach().exp().numpy(), report)
