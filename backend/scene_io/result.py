"""Imports the result of a reconstruction into a Blender file: the object, and the light around it as a World."""

import os
from pathlib import Path

import bpy

from .asset_import import import_asset, removed_on_error
from .data_blocks.asset_images import ASSET_KEY
from .world import build_world, renew_world


def import_result(
    folder: Path, collection: bpy.types.Collection, *, name: str = "", pack: bool = True
) -> tuple[bpy.types.Object, bpy.types.World]:
    """Import the asset in `folder`, and return (object, World). A new World is named "<object> light".
    A World that came from this folder before is used again, with the light that the folder has now; so the artist's turn and
    strength stay.

    With `pack` the images are stored in the .blend. Otherwise they refer to the asset's files, by relative paths if the
    .blend is saved. Raises OSError where a file is missing or unreadable; nothing is left in the .blend then.
    """
    folder = Path(folder)
    with removed_on_error():
        item = import_asset(folder, collection, name=name, pack=pack)
        light, key = folder / "environment.exr", os.path.abspath(folder)
        earlier = (world for world in bpy.data.worlds if world.library is None and world.get(ASSET_KEY) == key)
        world = next((world for world in earlier if renew_world(world, light, pack=pack)), None)
        if world is None:
            world = build_world(light, name=f"{item.name} light", pack=pack)
            world[ASSET_KEY] = key
    return item, world
