"""Brings the finished objects of a batch into a scene, each once: as a row, marked as assets, in one collection.

An object whose asset was made anew is brought in again. It then takes the place of the one that is there.
"""

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import bpy

from ..engine.results.batch_file import BatchFile, BatchObject
from ..scene_io.asset_import import import_asset
from .catalogs import Catalog, catalog_of
from .marking import mark_as_asset
from .replacing import take_over
from .row import move_origin_to_base, place_in_row

ASSET = "nep_shelf_asset"
"""An object's custom property: the absolute path of its asset"""
MADE = "nep_shelf_made"
"""An object's custom property: `BatchObject.made` of the asset that it shows. Objects of older versions do not have it"""
BATCH, CATALOG, CATALOG_PATH = "nep_shelf", "nep_shelf_catalog", "nep_shelf_catalog_path"
"""A collection's custom properties: the absolute path of the batch, and the catalog of its objects"""


@dataclass
class BroughtIn:
    """What `bring_in` has done.

    `items`: the new objects. `renewed`: those that were there, and show an asset now that was made anew. `refused`: {name of
    an object that cannot be imported: why}.
    """

    items: list[bpy.types.Object] = field(default_factory=list)
    renewed: list[bpy.types.Object] = field(default_factory=list)
    refused: dict[str, str] = field(default_factory=dict)


def bring_in(batch: BatchFile, scene: bpy.types.Scene, progress: Callable[[int, int], None] | None = None) -> BroughtIn:
    """Import all objects of the batch that are done and not in the scene yet.

    They go into a collection of the batch, to the right of all shelf objects of the scene. An object that was there before
    its asset was made anew keeps its place, and gets the new mesh and material. Images are packed. An asset that cannot be
    imported is passed over. progress(number, count) is called before each import.
    """
    found, catalog = BroughtIn(), catalog_of(batch)
    missing = not_in_scene(batch, scene)
    if not missing:
        return found
    collection = _collection(batch, scene, catalog)
    before, there = shelf_objects(scene), objects_of(batch, scene)
    for number, one in enumerate(missing):
        if progress:
            progress(number, len(missing))
        old = there.get(one.name, [])
        if any(other.type != "MESH" for other in old):  # converted by the artist
            found.refused[one.name] = "it was made anew, and the object in the scene is no mesh any more. Delete that first"
            continue
        try:
            item = import_asset(one.folder, collection, name=one.name)
        except OSError as error:
            found.refused[one.name] = str(error)
            continue
        move_origin_to_base(item)
        if old:
            take_over(old, item)
        for shown in old or [item]:
            shown[ASSET], shown[MADE] = _key(one.folder), one.made
            mark_as_asset(shown, one.folder, catalog, batch.preset)
        found.renewed += old
        found.items += [] if old else [item]
    place_in_row(found.items, before)
    return found


def not_in_scene(batch: BatchFile, scene: bpy.types.Scene) -> list[BatchObject]:
    """The objects of the batch that are done, and are not in the scene yet, or only as they were before they were made anew.

    A copy that was taken from the Asset Browser, or made with Duplicate, does not count: Blender does not mark it as an
    asset, or it is linked.
    """
    there = objects_of(batch, scene)
    return [one for one in batch.done if one.name not in there or not _are_current(there[one.name], one)]


def _are_current(items: list[bpy.types.Object], one: BatchObject) -> bool:
    return not one.made or all(item.get(MADE) in (None, one.made) for item in items)


def objects_of(batch: BatchFile, scene: bpy.types.Scene) -> dict[str, list[bpy.types.Object]]:
    """{name in the batch: its objects in the scene, in whatever collections}, for objects of the batch that are done.

    An object is known by the path of its asset. After the project was moved, it is known by its catalog and by the name of
    its asset's folder.
    """
    of_path = {_key(one.folder): one.name for one in batch.done}
    of_folder = {os.path.basename(path): name for path, name in of_path.items()}
    found: dict[str, list[bpy.types.Object]] = {}
    catalog = ""
    for item in shelf_objects(scene):
        name = of_path.get(item[ASSET])
        if name is None:
            catalog = catalog or catalog_of(batch).identifier  # not before it is needed, because a file is read
            if item.asset_data.catalog_id == catalog:
                name = of_folder.get(os.path.basename(item[ASSET]))
        if name is not None:
            found.setdefault(name, []).append(item)
    return found


def shelf_collection(folder: Path, scene: bpy.types.Scene) -> bpy.types.Collection | None:
    """The scene's collection of the objects of the batch in `folder`; None where none was brought in."""
    return next((child for child in _shelf_collections(scene) if child[BATCH] == _key(folder)), None)


def _shelf_collections(scene: bpy.types.Scene) -> list[bpy.types.Collection]:
    """The scene's collections of batches. Linked ones cannot take objects, so they are left out."""
    return [child for child in scene.collection.children_recursive if child.get(BATCH) and child.library is None]


def shelf_objects(place: bpy.types.Collection | bpy.types.Scene) -> list[bpy.types.Object]:
    """The objects of batches in a collection or a scene, without what somebody else has put there."""
    own = (item for item in place.objects if item.library is None)
    return [item for item in own if item.get(ASSET) and item.asset_data is not None]


def catalog_of_collection(collection: bpy.types.Collection) -> Catalog | None:
    """The catalog of the objects in a collection; None where it is not the collection of a batch."""
    identifier, path = collection.get(CATALOG), collection.get(CATALOG_PATH)
    return Catalog(str(identifier), str(path)) if identifier and path else None


def _collection(batch: BatchFile, scene: bpy.types.Scene, catalog: Catalog) -> bpy.types.Collection:
    found = shelf_collection(batch.folder, scene)
    if found is None:  # none yet, or the project was moved
        found = next((child for child in _shelf_collections(scene) if child.get(CATALOG) == catalog.identifier), None)
    if found is None:
        found = bpy.data.collections.new(f"Shelf: {batch.folder.resolve().name}")
        scene.collection.children.link(found)
    found[BATCH], found[CATALOG], found[CATALOG_PATH] = _key(batch.folder), catalog.identifier, catalog.path
    return found


def _key(folder: Path) -> str:
    """One string for all ways to write the path of the same folder."""
    return os.path.normcase(os.path.abspath(folder))
