"""The result of a job in the artist's scene: the object, and the recovered light as the scene's World."""

from pathlib import Path

import bpy

from ...backend.engine.results.job_files import is_asset, read_job
from ...backend.scene_io.data_blocks.asset_images import move_images
from ...backend.scene_io.image_files import relative_path
from ...backend.scene_io.result import import_result
from ..folders import folder_key, resolve_folder
from . import lit_view
from .imported_materials import fill_materials, is_list_of

JOB_KEY = "nep_job"  # property of an imported object: the job that has made it


def place_result(scene: bpy.types.Scene, folder: Path, collection: bpy.types.Collection | None = None) -> bpy.types.Object:
    """Import the asset in `folder` into a collection of the scene (None: its main one); returns the object.

    The selection stays as it is. The light becomes `scene.nep.recovered_world`. The scene's own World stays in use; where
    the recovered light of an older result is in use, the new one takes its place. `scene.nep.materials` lists the result's
    materials. OSError where a file of the asset is missing or cannot be read.
    """
    settings = scene.nep
    lit_by_earlier = is_recovered_light_used(scene)
    item, world = import_result(folder, collection or scene.collection, pack=settings.images == "PACKED")
    if lit_by_earlier:
        scene.world = world
    settings.recovered_world, settings.asset = world, _setting_of(settings, folder)
    fill_materials(settings, folder)
    settings.imported_job = item[JOB_KEY] = _last_job_identifier(folder)
    return item


def _setting_of(settings: bpy.types.PropertyGroup, folder: Path) -> str:
    """The path of a result's folder as a setting; relative where the output folder is, so that a moved project finds it."""
    return relative_path(folder) if bpy.data.is_saved and settings.output.startswith("//") else str(folder)


def is_result_gone(settings: bpy.types.PropertyGroup) -> bool:
    """Whether a result was imported, and its folder was renamed, moved or removed since."""
    folder = resolve_folder(settings.asset)
    return folder is not None and not folder.is_dir()


def relink(scene: bpy.types.Scene, folder: Path) -> None:
    """Let the imported result be the one in `folder`: it is the same one, which was renamed or moved.

    The object stays as it is, with its corrections. ValueError, with words for the artist, where `folder` holds no result or
    another one.
    """
    settings, old = scene.nep, resolve_folder(scene.nep.asset)
    if not is_asset(folder):
        raise ValueError(f"There is no finished result in {folder}. Choose the folder with report.json and mesh.obj")
    job, known = _last_job_identifier(folder), settings.imported_job
    same = job == known or (read_job(folder) is None and is_list_of(settings, folder))
    if not same:
        raise ValueError(f"{folder} holds another result. Import it instead: a second object comes into the scene")
    if old is not None:
        move_images(old, folder)
        output = resolve_folder(settings.output)
        if output is not None and folder_key(output) == folder_key(old):
            settings.output = _setting_of(settings, folder)
    for item in _objects_of(scene, known):
        item[JOB_KEY] = job
    settings.imported_job, settings.asset = job, _setting_of(settings, folder)


def has_new_result(scene: bpy.types.Scene) -> bool:
    """Whether the scene's output folder holds an asset whose object is not in the scene, or not any more."""
    output = resolve_folder(scene.nep.output)
    return output is not None and is_asset(output) and not _objects_of(scene, _last_job_identifier(output))


def result_object(scene: bpy.types.Scene) -> bpy.types.Object | None:
    """The object that was imported last: of several, the active one, or else the newest. None where it was deleted."""
    found = _objects_of(scene, scene.nep.imported_job)
    active = scene.view_layers[0].objects.active
    return active if active in found else max(found, key=lambda item: item.session_uid, default=None)


def _objects_of(scene: bpy.types.Scene, job: str) -> list[bpy.types.Object]:
    return [item for item in scene.objects if item.get(JOB_KEY) == job] if job else []


def _last_job_identifier(output: Path) -> str:
    """Differs between two jobs in the same folder. An asset without a job's files is identified by its folder."""
    return str((read_job(output) or {}).get("id") or folder_key(output))


def is_recovered_light_used(scene: bpy.types.Scene) -> bool:
    """Whether the recovered light is the scene's World."""
    return scene.nep.recovered_world is not None and scene.world == scene.nep.recovered_world


def switch_light(scene: bpy.types.Scene) -> None:
    """Change between the recovered light and the artist's own World. With the own World, the own lamps are on again."""
    settings = scene.nep
    if is_recovered_light_used(scene):
        scene.world, settings.own_world = settings.own_world, None
        lit_view.lamps_back(scene)
    else:
        settings.own_world, scene.world = scene.world, settings.recovered_world


def is_lit(scene: bpy.types.Scene, viewport: tuple[bpy.types.Screen, bpy.types.Area] | None) -> bool:
    """Whether this viewport was made to show the recovered light, and the scene has it still."""
    return is_recovered_light_used(scene) and (viewport is None or lit_view.is_shown(*viewport))
