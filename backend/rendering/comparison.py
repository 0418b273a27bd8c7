"""Renders comparison.png: photos beside renderings of the asset.

Each row shows a photo, the same view rendered under the recovered light, and the same view under each of the other lights.
A turntable below the rows, if one is asked for, shows the object under one light. The tiles are sRGB-encoded, as by
Blender's view transform Standard, which changes no hue. A photo and its re-rendering share one exposure and white balance;
where those differ from photo to photo, these are the photo's own. Where the asset's report says that the object is brighter
in a photo than in others, so is the object in the re-rendering, and not what is behind it. Every other light has its own
exposure. Where Blender does not show the format of a photo, its name stands in its place.
"""

from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np

from ..scene_io.capture_files import Frame, UnshownPhoto
from ..scene_io.image_files import write_png
from ..scene_io.photo_alpha import shown_whole
from ..scene_io.srgb import linear_to_srgb
from .contact_sheet import draw_sheet, empty_tile, in_cell, strip_tile_size
from .exposure import exposure
from .relight import RelitScene
from .response_curve import seen_by_camera
from .turntable import turntable_frames

TILE_RANGE = (320, 448)  # smallest and largest number of pixels of a tile's longer side


def compare(
    item: bpy.types.Object,
    frames: list[Frame],
    recovered: bpy.types.World,
    worlds: list[bpy.types.World],
    *,
    samples: int = 64,
    seed: int = 0,
    turntable: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> tuple[np.ndarray, list[float]]:
    """Render `item` from the photos' cameras under the World `recovered` and under `worlds`.

    Beside the photos, under `recovered`, the renderings have the camera's response curve, if the frames tell one. Returns
    the sheet [H,W,3] uint8, and for each row the factor by which its photo was made brighter. `turntable` is the number of
    views around the object. These views are rendered under the first of `worlds`, or under `recovered` where `worlds` is
    empty. `samples` is the number of Cycles samples a pixel. progress(done, total) is called after every render. Raises
    OSError where a photo cannot be read.
    """
    sizes = [_tile_size(frame) for frame in frames]
    width, height = max(width for width, _ in sizes), max(height for _, height in sizes)
    columns, done, total = 2 + len(worlds), 0, len(frames) * (1 + len(worlds)) + turntable

    def rendered(relit: RelitScene, frame: Frame, world: bpy.types.World, object_gain: float = 1.0) -> np.ndarray:
        nonlocal done
        radiance = relit.render_brightened(frame, world, object_gain)
        done += 1
        if progress:
            progress(done, total)
        return radiance

    rows, gains = [], []
    with RelitScene(item, width, height, samples, seed) as relit:
        for frame, size in zip(shown_whole(frames), sizes, strict=True):
            relit.set_size(*size)
            lit = rendered(relit, frame, recovered, frame.object_gain)
            again = seen_by_camera(lit, frame.response) * np.array(frame.gain)
            again = seen_by_camera(again, frame.curve_of_files)
            photo = _photo(frame, *size)
            gain = 1.0 if frame.color_space == "srgb" else exposure(again if photo is None else photo)
            others = [rendered(relit, frame, world) for world in worlds]
            tiles = [linear_to_srgb(again * gain), *(linear_to_srgb(tile * exposure(tile)) for tile in others)]
            first = empty_tile(*size, f"{frame.path.name} is not shown") if photo is None else linear_to_srgb(photo * gain)
            rows.append([in_cell(tile, width, height) for tile in (first, *tiles)])
            gains.append(gain)
    strip: list[np.ndarray] = []
    light = (worlds or [recovered])[0]
    if turntable:
        side = strip_tile_size(columns, width, height, turntable)
        with RelitScene(item, side, side, samples, seed) as relit:
            strip = [rendered(relit, frame, light) for frame in turntable_frames(item, frames, turntable, side)]
        gain = exposure(np.concatenate(strip))
        strip = [linear_to_srgb(tile * gain) for tile in strip]
    titles = [
        f"photo {frames[0].path.name}" if len(frames) == 1 else "photo",
        "re-rendered, recovered light",
        *(f"light: {world.name}" for world in worlds),
    ]
    return draw_sheet(rows, titles, _subtitle(gains), strip, f"turntable, light: {light.name}"), gains


def write_comparison(path: Path, sheet: np.ndarray) -> None:
    """Write the sheet as a PNG file, under a temporary name that is then changed to `path`."""
    write_png(path, sheet)


def resize(image: np.ndarray, width: int, height: int) -> np.ndarray:
    """Resize an image [h,w,3] to [height,width,3].

    Along an axis that shrinks, pixels are means over areas. Along an axis that grows, they are interpolated linearly.
    """
    for axis, size in ((0, height), (1, width)):
        image = np.moveaxis(_resize_rows(np.moveaxis(image, axis, 0), size), 0, axis)
    return image


def _resize_rows(image: np.ndarray, size: int) -> np.ndarray:
    count = len(image)
    if size < count:  # exact means over areas, from cumulative sums
        total = np.concatenate([np.zeros_like(image[:1], np.float64), np.cumsum(image, axis=0, dtype=np.float64)])
        edges = np.arange(size + 1) * count / size
        low = np.minimum(edges.astype(int), count - 1)
        part = (edges - low).reshape(-1, *[1] * (image.ndim - 1))
        at = total[low] * (1 - part) + total[low + 1] * part
        return (at[1:] - at[:-1]) * (size / count)
    center = np.clip((np.arange(size) + 0.5) * count / size - 0.5, 0, count - 1)
    low = np.minimum(center.astype(int), max(count - 2, 0))
    part = (center - low).reshape(-1, *[1] * (image.ndim - 1))
    return image[low] * (1 - part) + image[np.minimum(low + 1, count - 1)] * part


def _photo(frame: Frame, width: int, height: int) -> np.ndarray | None:
    """The photo as linear radiance at this size; None where Blender does not show its format."""
    try:
        return resize(frame.photo(), width, height)
    except UnshownPhoto:
        return None


def _tile_size(frame: Frame) -> tuple[int, int]:
    longer = max(frame.width, frame.height)
    scale = min(max(longer, TILE_RANGE[0]), TILE_RANGE[1]) / longer
    return max(1, round(frame.width * scale)), max(1, round(frame.height * scale))


def _subtitle(gains: list[float]) -> str:
    stops = ", ".join(f"{np.log2(gain):+.1f}" for gain in gains)
    return f"View transform Standard. Exposure of photo and re-rendering, row by row: {stops} EV; other lights: own."
