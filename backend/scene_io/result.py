"""The result of a reconstruction in a Blender file: the object, and the light around it as a World."""

from pathlib import Path

from .asset_import import import_asset, nothing_half_made
from .world import build_world


def import_result(folder: Path, collection, *, name: str = "", pack: bool = True):
    """(object, World "<object> light") of the asset in `folder`. OSError where a file is missing or unreadable.

    `pack`: images inside the .blend; else they refer to the asset's files, relative to the .blend where it is saved.
    """
    folder = Path(folder)
    with nothing_half_made():
        item = import_asset(folder, collection, name=name, pack=pack)
        world = build_world(folder / "environment.exr", name=f"{item.name} light", pack=pack)
    return item, world
