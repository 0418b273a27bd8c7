"""Shows an asset from all sides in another light, in Cycles: `python -m examples.relight_asset asset/ light.exr out.png`.

`light.exr` is an equirectangular picture. The bpy wheel is needed. In Blender, the same functions are in the extension.
"""

import sys
from pathlib import Path

import bpy

from backend.rendering.turntable import render_turntable
from backend.scene_io.asset_import import import_asset
from backend.scene_io.capture_files import read_frames
from backend.scene_io.image_files import write_png
from backend.scene_io.world import build_world


def relight(asset: Path, light: Path, picture: Path) -> None:
    """Write eight views of `asset` in `light`, side by side, to the PNG file `picture`. Raises OSError and ValueError."""
    item = import_asset(asset, bpy.context.collection)
    cameras = read_frames(asset.resolve(), "cameras.json")  # they say which way is up
    write_png(picture, render_turntable(item, cameras, build_world(light, name=light.stem)))


if __name__ == "__main__":
    relight(*map(Path, sys.argv[1:4]))
