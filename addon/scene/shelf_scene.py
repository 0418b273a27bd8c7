"""The objects of a batch in the artist's scene, and the asset library that other scenes take them from."""

from pathlib import Path

import bpy
from bpy.app.handlers import persistent

from ...backend.engine.results.batch_file import BatchFile
from ...backend.scene_io.blend_backup import put_in_place
from ...backend.scene_io.image_files import fresh_partial
from ...backend.shelf.bring_in import BATCH, catalog_of_collection, not_in_scene, objects_of
from ...backend.shelf.catalogs import add_catalogs, catalog_of
from ..folders import folder_key

BLEND_FILE = "shelf.blend"


def count_missing(batch: BatchFile, scene: bpy.types.Scene) -> int:
    """How many objects of the batch are done, and are not in the scene yet."""
    return len(not_in_scene(batch, scene))


def write_catalogs_of_file() -> str:
    """Write the catalogs of all shelves in this file to where the Asset Browser looks for them.

    That is the top of the asset library in which the .blend file lies, or else the file's own folder. Nothing is written
    for a file that was not saved yet. Returns why they cannot be written; empty where they are.
    """
    found = [catalog_of_collection(collection) for collection in bpy.data.collections if collection.get(BATCH)]
    catalogs = [catalog for catalog in found if catalog is not None]
    if not catalogs or not bpy.data.is_saved:
        return ""
    try:
        add_catalogs(_library_of_file(), catalogs)
    except (OSError, ValueError) as error:
        return str(error)
    return ""


def _library_of_file() -> Path:
    folder = Path(bpy.data.filepath).parent
    libraries = (Path(bpy.path.abspath(library.path)) for library in _libraries() if library.path)
    return next(
        (library for library in libraries if folder_key(library) in map(folder_key, (folder, *folder.parents))), folder
    )


@persistent
def on_file_saved(*_: object) -> None:
    """Blender's handler after a file was saved: only now the catalogs have a place."""
    write_catalogs_of_file()


def refresh_asset_browsers() -> None:
    """Let all Asset Browsers read their library again."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.ui_type == "ASSETS":
                region = next(region for region in area.regions if region.type == "WINDOW")
                with bpy.context.temp_override(window=window, area=area, region=region):
                    if bpy.ops.asset.library_refresh.poll():
                        bpy.ops.asset.library_refresh()


def write_shelf_file(batch: BatchFile, scene: bpy.types.Scene) -> Path:
    """Write FOLDER/shelf.blend with the objects of the batch, and their catalog beside it. Returns its path.

    A file that is younger than all objects stays. The file is replaced as a whole. Raises ValueError where the scene lacks
    objects of the batch, so that the file would lack them, too, and where the file is open, so that all else in it would be
    lost; OSError and RuntimeError where it cannot be written.
    """
    path = batch.folder / BLEND_FILE
    items = [item for found in objects_of(batch, scene).values() for item in found]
    if not _is_current(path, batch):
        if _is_open(path):
            raise ValueError(
                "shelf.blend itself is open, and would be replaced as a whole. Save it under another name first"
            )
        if not items or not_in_scene(batch, scene):
            raise ValueError("Press Bring In Objects first: shelf.blend is made of the objects in the scene")
        _write(path, items)
    add_catalogs(batch.folder, [catalog_of(batch)])
    return path


def _is_current(path: Path, batch: BatchFile) -> bool:
    try:
        written = path.stat().st_mtime
        return all((one.folder / "report.json").stat().st_mtime <= written for one in batch.done)
    except OSError:
        return False


def _is_open(path: Path) -> bool:
    return bpy.data.is_saved and folder_key(Path(bpy.data.filepath).resolve()) == folder_key(path.resolve())


def _write(path: Path, items: list[bpy.types.Object]) -> None:
    partial = fresh_partial(path, "partial_" + path.name)
    shown = bpy.data.scenes.new(path.stem)  # so that the objects are seen where the file is opened
    try:
        for item in items:
            shown.collection.objects.link(item)
        # Blender 5.2 ends with a segmentation fault where it writes a scene that was made after the last update of a scene.
        # One update serves all scenes of the file, also those that the objects refer to.
        shown.view_layers[0].update()
        bpy.data.libraries.write(str(partial), {shown, *items}, fake_user=True, compress=True)
    finally:
        bpy.data.scenes.remove(shown)
    put_in_place(partial, path)


def is_asset_library(folder: Path) -> bool:
    """Whether the folder is one of Blender's asset libraries."""
    return any(folder_key(bpy.path.abspath(library.path)) == folder_key(folder) for library in _libraries() if library.path)


def add_asset_library(folder: Path) -> None:
    """Make the folder one of Blender's asset libraries, for all files.

    Blender saves its preferences at its end, unless the user has turned that off.
    """
    _libraries().new(name=folder.name, directory=str(folder))
    bpy.context.preferences.is_dirty = True


def _libraries() -> bpy.types.AssetLibraryCollection:
    return bpy.context.preferences.filepaths.asset_libraries
