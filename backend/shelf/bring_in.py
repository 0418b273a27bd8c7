"""Brings the finished objects of a batch into a scene, each once: as a row, marked as assets, in one collection."""

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import bpy

from ..engine.batch_file import BatchFile, BatchObject
from ..scene_io.asset_import import import_asset
from .catalogs import Catalog, catalog_of
from .marking import mark_as_asset
from .row import move_origin_to_base, place_in_row

ASSET = "nep_shelf_asset"
"""An object's custom property: the absolute path of its asset"""
BATCH, CATALOG, CATALOG_PATH = "nep_shelf", "nep_shelf_catalog", "nep_shelf_catalog_path"
"""A collection's custom properties: the absolute path of the batch, and the catalog of its objects"""


@dataclass
class BroughtIn:
    """What `bring_in` has done: the new objects, and {name of an object that cannot be imported: why}."""

    items: list[bpy.types.Object] = field(default_factory=list)
    refused: dict[str, str] = field(default_factory=dict)


def bring_in(batch: BatchFile, scene: bpy.types.Scene, progress: Callable[[int, int], None] | None = None) -> BroughtIn:
    """Import all objects of the batch that are done and not in the scene yet.

    They go into a collection of the batch, to the right of all shelf objects of the scene. Images are packed. An asset that
    cannot be imported is passed over. progress(number, count) is called before each import.
    """
    found, catalog = BroughtIn(), catalog_of(batch)
    missing = not_in_scene(batch, scene)
    if not missing:
        return found
    collection = _collection(batch, scene, catalog)
    before = shelf_objects(scene)
    for number, one in enumerate(missing):
        if progress:
            progress(number, len(missing))
        try:
            item = import_asset(one.folder, collection, name=one.name)
        except OSError as error:
            found.refused[one.name] = str(error)
            continue
        move_origin_to_base(item)
        item[ASSET] = _key(one.folder)
        mark_as_asset(item, one.folder, catalog, batch.preset)
        found.items.append(item)
    place_in_row(found.items, before)
    return found


def not_in_scene(batch: BatchFile, scene: bpy.types.Scene) -> list[BatchObject]:
    """The objects of the batch that are done, and are not in the scene yet.

    A copy that was taken from the Asset Browser, or made with Duplicate, does not count: Blender does not mark it as an
    asset.
    """
    there = {item[ASSET] for item in objects_of(batch, scene)}
    return [one for one in batch.done if _key(one.folder) not in there]


def objects_of(batch: BatchFile, scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The scene's objects of the batch that are done, in whatever collection the artist has put them."""
    done = {_key(one.folder) for one in batch.done}
    return [item for item in shelf_objects(scene) if item[ASSET] in done]


def shelf_collection(folder: Path, scene: bpy.types.Scene) -> bpy.types.Collection | None:
    """The scene's collection of the objects of the batch in `folder`; None where none was brought in."""
    children = scene.collection.children_recursive
    return next((child for child in children if child.get(BATCH) == _key(folder)), None)


def shelf_objects(place: bpy.types.Collection | bpy.types.Scene) -> list[bpy.types.Object]:
    """The objects of batches in a collection or a scene, without what somebody else has put there."""
    return [item for item in place.objects if item.get(ASSET) and item.asset_data is not None]


def catalog_of_collection(collection: bpy.types.Collection) -> Catalog | None:
    """The catalog of the objects in a collection; None where it is not the collection of a batch."""
    identifier, path = collection.get(CATALOG), collection.get(CATALOG_PATH)
    return Catalog(str(identifier), str(path)) if identifier and path else None


def _collection(batch: BatchFile, scene: bpy.types.Scene, catalog: Catalog) -> bpy.types.Collection:
    found = shelf_collection(batch.folder, scene)
    if found is None:
        found = bpy.data.collections.new(f"Shelf: {batch.folder.resolve().name}")
        found[BATCH] = _key(batch.folder)
        found[CATALOG], found[CATALOG_PATH] = catalog.identifier, catalog.path
        scene.collection.children.link(found)
    return found


def _key(folder: Path) -> str:
    """One string for all ways to write the path of the same folder."""
    return os.path.normcase(os.path.abspath(folder))
