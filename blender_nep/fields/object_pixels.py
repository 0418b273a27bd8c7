"""Chooses the pixels for fields learning. Object pixels get rays of their own. Some pixels are held out for validation."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from blender_nep.capture.pixel_rays import PixelRays
from blender_nep.capture.pixel_set import GrowingPixelSet, PixelSet
from blender_nep.fields.object_field import SplineShape
from blender_nep.geometry.mesh import Surface
from blender_nep.geometry.ray_tracing import RayTracer
from blender_nep.profiling import profiled


@profiled("object pixels")
@torch.no_grad()
def find_object_pixels(rays: PixelRays, shape: SplineShape, band: float, block: int = 4) -> PixelSet:
    """The object pixels: valid pixels whose rays come nearer to the surface than `band` (unit frame), and some around them.

    One ray for each block of `block` x `block` pixels is tried. A block is taken if its ray or the ray of a neighbouring
    block is near. If there are no such pixels, the result is all pixels that see the object's sphere.
    """
    device = rays.valid.device
    found = GrowingPixelSet(device)
    for view, (height, width) in enumerate(rays.size):
        row = torch.arange(0, height, block, device=device).add(block // 2).clamp(max=height - 1)
        column = torch.arange(0, width, block, device=device).add(block // 2).clamp(max=width - 1)
        index = (rays.offset[view] + row[:, None] * width + column).flatten()
        origins, directions, _ = rays.rays(index)
        seen = shape.near(origins, directions, band).float().reshape(1, 1, len(row), len(column))
        seen = functional.max_pool2d(seen, 3, 1, 1)
        seen = seen[0, 0].repeat_interleave(block, 0)[:height].repeat_interleave(block, 1)[:, :width] > 0
        valid = rays.valid[rays.offset[view] : rays.offset[view + 1]]
        found.add(PixelSet.where(seen.flatten() & valid, rays.offset[view]))
    pixels = found.finished()
    return pixels if len(pixels) else rays.sphere


def held_out(index: Tensor, every: int) -> Tensor:
    """Whether the pixels index [n] are held out from learning: [n] bool. Every `every`-th of all pixels is held out."""
    return index % every == 0


def held_out_pixels(pixels: PixelSet, every: int, most: int) -> Tensor:
    """Indices [m] of the held-out pixels among `pixels`. If there are more than `most`, they are thinned evenly to about
    `most`."""
    index = torch.cat([part[held_out(part, every)] for part in pixels.split(1 << 20)])
    return index[:: max(1, len(index) // most)]


@profiled("draw pixels")
def draw_pixels(pool: PixelSet | Tensor, count: int, every: int, generator: torch.Generator) -> Tensor:
    """About `count` random pixels [m] of the pool that are not held out.

    If all drawn pixels are held out, these are returned all the same.
    """
    index = pool[torch.randint(len(pool), (count,), generator=generator, device=generator.device)]
    learned = index[~held_out(index, every)]
    return learned if len(learned) else index


def pixels_beside(surface: Surface, rays: PixelRays, chunk: int = 1 << 18) -> PixelSet:
    """The valid pixels whose rays miss the mesh."""
    tracer = RayTracer(surface.vertices, surface.faces)
    beside = [rays.outside]
    for index in rays.sphere.split(chunk):
        origins, directions, _ = rays.rays(index)
        hit = tracer.occluded(origins.cpu().numpy(), directions.cpu().numpy())
        beside.append(PixelSet.of(index[torch.from_numpy(~hit).to(index.device)]))
    return PixelSet.joined(beside)
