"""Imports a finished asset into an empty file and renders comparison.png: the photos beside the asset in several lights."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import bpy

from ..rendering.comparison import compare, write_comparison
from ..scene_io.asset_import import import_asset
from ..scene_io.capture_files import Frame, read_frames_of, spread_frames, with_exposures
from ..scene_io.color_spaces import use_standard_view
from ..scene_io.world import blender_hdris, build_world
from .stop_requests import say

COMPARISON = "comparison.png"


@dataclass(frozen=True)
class Effort:
    """How much is rendered. `relight`: number of HDRIs. `photos`: number of photos. `samples`: of Cycles, for each pixel."""

    relight: int
    photos: int
    samples: int
    seed: int = 0


@dataclass(frozen=True)
class RelitAsset:
    """An asset in this Blender. `frames`: all photos. `compared`: those of the comparison. `lights`: Worlds of HDRIs."""

    item: bpy.types.Object
    frames: list[Frame]
    compared: list[Frame]
    recovered: bpy.types.World
    lights: list[bpy.types.World]


def import_for_relighting(asset: Path, capture: Path, effort: Effort) -> RelitAsset:
    """Import the asset into an empty file, with the recovered light as World, and with the Worlds of HDRIs.

    Raises OSError or ValueError where files are missing or cannot be read.
    """
    frames = with_exposures(read_frames_of(capture, asset), asset)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    use_standard_view(scene)
    item = import_asset(asset, scene.collection)
    scene.world = recovered = build_world(asset / "environment.exr", name="recovered light")
    hdris = blender_hdris()[: effort.relight]
    if len(hdris) < effort.relight:
        say(f"warning: this Blender ships {len(hdris)} HDRIs; {effort.relight} were asked for")
    lights = [build_world(path, name=path.stem) for path in hdris]
    return RelitAsset(item, frames, spread_frames(frames, effort.photos), recovered, lights)


def write_relit_comparison(relit: RelitAsset, asset: Path, effort: Effort, progress: Callable[[int, int], None]) -> None:
    """Render comparison.png into the asset's folder. progress(done, total) is called after every render."""
    sheet, _ = compare(
        relit.item,
        relit.compared,
        relit.recovered,
        relit.lights,
        samples=effort.samples,
        seed=effort.seed,
        progress=progress,
    )
    write_comparison(asset / COMPARISON, sheet)
