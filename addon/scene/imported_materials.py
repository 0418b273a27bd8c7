"""The materials of the imported result: the list in the scene's settings, and the textures in the .blend file.

Each material of the list has what the photos said, what the textures have now, and what the artist corrects. `applied_…`
is the correction that the textures have; it is empty where there is none.
"""

from pathlib import Path

import bpy

from ...backend.engine.results.asset_materials import AssetMaterial, read_materials
from ...backend.scene_io.data_blocks.asset_images import reload_textures
from ..folders import folder_key, resolve_folder
from ..properties import NepMaterial, NepSettings

METALLIC = {"METAL": 1.0, "NOT_METAL": 0.0}  # "AS_LEARNED" has no value
DIGITS = 4  # after the point, of a roughness: Blender stores it in single precision

Corrections = dict[int, dict[str, float]]
"""Number of a material -> its corrected values, by the names `metallic` and `roughness`."""


def fill_materials(settings: NepSettings, asset: Path) -> None:
    """Put the materials that the asset's report names into the list, with the corrections that the report names."""
    settings.materials.clear()
    for material in read_materials(asset):
        _fill(settings.materials.add(), material)
    settings.material_index = min(settings.material_index, max(len(settings.materials) - 1, 0))


def _fill(item: NepMaterial, material: AssetMaterial) -> None:
    item.share, item.albedo = material.share, material.albedo
    item.roughness, item.is_metal = material.roughness, material.is_metal
    item.learned_roughness, item.learned_is_metal = material.learned_roughness, material.learned_is_metal
    metallic, roughness = material.correction.get("metallic"), material.correction.get("roughness")
    item.metal = "AS_LEARNED" if metallic is None else "METAL" if metallic > 0.5 else "NOT_METAL"
    item.set_roughness = roughness is not None
    item.new_roughness = material.roughness if roughness is None else roughness
    item.applied_metal = item.metal
    item.applied_roughness = -1 if roughness is None else item.new_roughness


def _correction(metal: str, roughness: float | None) -> dict[str, float]:
    found = {"metallic": METALLIC[metal]} if metal in METALLIC else {}
    return found if roughness is None else found | {"roughness": round(roughness, DIGITS)}


def chosen_correction(item: NepMaterial) -> dict[str, float]:
    """What the artist corrects of this material."""
    return _correction(item.metal, item.new_roughness if item.set_roughness else None)


def applied_correction(item: NepMaterial) -> dict[str, float]:
    """What the textures have of it."""
    return _correction(item.applied_metal, None if item.applied_roughness < 0 else item.applied_roughness)


def chosen_corrections(settings: NepSettings) -> Corrections:
    """What the artist corrects of the imported result. Materials without a correction are left out."""
    return {number: found for number, item in enumerate(settings.materials) if (found := chosen_correction(item))}


def applied_corrections(settings: NepSettings) -> Corrections:
    """What the textures of the imported result have of it."""
    return {number: found for number, item in enumerate(settings.materials) if (found := applied_correction(item))}


def is_list_of(settings: NepSettings, asset: Path) -> bool:
    """Whether the list is that of the asset. It is not where another job has written the folder since the import."""
    materials = read_materials(asset)
    return len(materials) == len(settings.materials) and all(
        item.learned_is_metal == material.learned_is_metal
        and abs(item.learned_roughness - material.learned_roughness) < 10**-DIGITS
        for item, material in zip(settings.materials, materials, strict=True)
    )


def scenes_with(asset: Path) -> list[bpy.types.Scene]:
    """The scenes of this file into which the asset was imported last."""
    folders = ((scene, resolve_folder(scene.nep.asset)) for scene in bpy.data.scenes)
    return [scene for scene, folder in folders if folder is not None and folder_key(folder) == folder_key(asset)]


def reload_result(asset: Path) -> int:
    """Read the textures and the materials of the asset again, in all scenes. Returns the number of images that were read.

    A file without this asset stays as it is.
    """
    scenes = scenes_with(asset)
    for scene in scenes:
        fill_materials(scene.nep, asset)
    return reload_textures(asset) if scenes else 0
