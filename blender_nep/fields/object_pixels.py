"""Chooses the pixels for fields learning. Object pixels get rays of their own. Some pixels are held out for validation."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from torch import Tensor
from torch.nn import functional

from blender_nep.capture.rays.pixel_rays import PixelRays
from blender_nep.capture.rays.pixel_set import GrowingPixelSet, PixelSet, random_places
from blender_nep.capture.rays.ray_bundle import RayBundle
from blender_nep.fields.object.field import SplineShape
from blender_nep.geometry.mesh import Surface
from blender_nep.geometry.ray_tracing import RayTracer
from blender_nep.presets import FieldsPreset
from blender_nep.profiling import profiled

_CLEAR = 0.97
"""F_e does not count in front of a pixel if its transmittance there is at least this."""


@dataclass(frozen=True)
class ObjectPixels:
    """The object pixels, in two sets."""

    clear: PixelSet
    """Pixels in front of which F_e is clear: nothing stands between the camera and the object's sphere"""
    veiled: PixelSet
    """All other object pixels"""

    def __len__(self) -> int:
        return len(self.clear) + len(self.veiled)

    def joined(self) -> PixelSet:
        """All object pixels in one set."""
        return PixelSet.joined([self.veiled, self.clear])

    def draw(self, count: int, every: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
        """About `count` random pixels that are not held out: the clear ones [c] and the veiled ones [v], in int64. Both are
        in rising order (`random_places`)."""
        place = random_places(count, len(self), generator)
        clear, veiled = place[place < len(self.clear)], place[place >= len(self.clear)] - len(self.clear)
        clear, veiled = self.clear[clear], self.veiled[veiled]
        return clear[~held_out(clear, every)], veiled[~held_out(veiled, every)]

    def state(self) -> dict:
        """Both sets, as they are saved on the disk."""
        return {"clear": self.clear.state(), "veiled": self.veiled.state()}

    @classmethod
    def from_state(cls, state: dict, device: torch.device) -> ObjectPixels:
        """The inverse of `state`."""
        return cls(*(PixelSet.from_state(state[name]).to(device) for name in ("clear", "veiled")))


@profiled("object pixels")
@torch.no_grad()
def find_object_pixels(
    rays: PixelRays,
    shape: SplineShape,
    band: float,
    transmittance: Callable[[RayBundle], Tensor] | None,
    block: int = 4,
) -> ObjectPixels:
    """The object pixels: valid pixels whose rays come nearer to the surface than `band` (unit frame), and some around them.

    One ray for each block of `block` x `block` pixels is tried. A block is taken if its ray comes so near that the ray of
    one of its pixels may be near; rays that miss the sphere do not count. It is clear if F_e lets through nearly all light
    along its ray and its neighbors' rays: transmittance(rays) gives the share [n] of n rays; None: no block is clear. If
    there are no object pixels, all pixels that see the object's sphere are taken for veiled ones.
    """
    device = rays.valid.device
    clear, veiled = GrowingPixelSet(device), GrowingPixelSet(device)
    for view, (height, width) in enumerate(rays.size):
        row = torch.arange(0, height, block, device=device).add(block // 2).clamp(max=height - 1)
        column = torch.arange(0, width, block, device=device).add(block // 2).clamp(max=width - 1)
        index = (rays.offset[view] + row[:, None] * width + column).flatten()
        bundle = rays.rays(index)
        far = bundle.origins[0].norm() + 1  # the far side of the sphere, where pixels are widest
        corner = math.sqrt(2) * block * float(bundle.half_angle.max() * far)
        seen = shape.near(bundle.origins, bundle.directions, band + corner)
        veil = seen.clone()
        if transmittance is not None and seen.any():
            veil[seen] = transmittance(bundle[seen]) < _CLEAR
        veil = _around(veil, len(row), len(column))
        valid = rays.valid[rays.offset[view] : rays.offset[view + 1]]
        for blocks, found in ((seen & ~veil, clear), (seen & veil, veiled)):
            pixels = blocks.reshape(len(row), len(column)).repeat_interleave(block, 0)[:height]
            pixels = pixels.repeat_interleave(block, 1)[:, :width]
            found.add(PixelSet.where(pixels.flatten() & valid, rays.offset[view]))
    both = ObjectPixels(clear.finished(), veiled.finished())
    return both if len(both) else ObjectPixels(both.clear, rays.sphere)


def _around(flags: Tensor, rows: int, columns: int) -> Tensor:
    """Whether each block or one of its eight neighbors is flagged; flags and result [rows * columns] bool."""
    grid = flags.float().reshape(1, 1, rows, columns)
    return functional.max_pool2d(grid, 3, 1, 1).flatten() > 0


def fitted_to_widths(preset: FieldsPreset, rays: PixelRays) -> FieldsPreset:
    """The preset, with another `held_out_every` if a photo's width [pixels] is a multiple of it.

    Of such a photo, all pixels of some columns would be held out, and none of the others. Then the next larger number is
    taken that shares no factor with the width of any photo.
    """
    widths, every = {width for _, width in rays.size}, preset.held_out_every
    if any(width % every == 0 for width in widths):
        every += 1
        while any(math.gcd(width, every) > 1 for width in widths):
            every += 1
    return replace(preset, held_out_every=every)


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
    """About `count` random pixels [m] of the pool that are not held out, in the pool's order (`random_places`).

    If all drawn pixels are held out, these are returned all the same.
    """
    index = pool[random_places(count, len(pool), generator)]
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
