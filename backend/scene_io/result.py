"""Imports the result of a reconstruction into a Blender file: the object, and the light around it as a World."""

from pathlib import Path

import bpy

from .asset_import import import_asset, removed_on_error
from .world import build_world


def import_result(
    folder: Path, collection: bpy.types.Collection, *, name: str = "", pack: bool = True
) -> tuple[bpy.types.Object, bpy.types.World]:
    """Import the asset in `folder`, and return (object, World). The World is named "<object> light".

    With `pack` the images are stored in the .blend. Otherwise they refer to the asset's files, by relative paths if the
    .blend is saved. Raises OSError where a file is missing or unreadable; nothing is left in the .blend then.
    """
    folder = Path(folder)
    with removed_on_error():
        item = import_asset(folder, collection, name=name, pack=pack)
        world = build_world(folder / "environment.exr", name=f"{item.name} light", pack=pack)
    return item, world
