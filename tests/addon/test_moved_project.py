"""A project whose folder gets another name: its .blend file, which names its folders by relative paths, finds them again."""

import json
import os
import shutil
import sys
from pathlib import Path

import pytest

from support import correcting_engine
from support.batch_folder import write_batch
from support.blender_checks import register
from support.own_process import in_blender


@pytest.fixture
def folder(package, monkeypatch):
    """A folder with `asset`, and an engine that corrects its materials."""
    correcting_engine.make_asset(package / "asset")
    monkeypatch.setenv("NEP_ENGINE_PYTHON", correcting_engine.make(package))
    return package


def opened(folder: Path):
    """A file that was saved in a new project, which has a copy of the asset as `result`; (bpy, the project)."""
    import bpy

    project = folder / "project"
    shutil.copytree(folder / "asset", project / "result")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(project / "scene.blend"))
    return bpy, project


def moved(bpy, project: Path) -> Path:
    """The project after its folder got another name, and its file was opened there."""
    bpy.ops.wm.save_mainfile()
    place = project.with_name("moved")
    os.rename(project, place)
    bpy.ops.wm.open_mainfile(filepath=str(place / "scene.blend"))
    return place


@pytest.mark.parametrize("images", ["PACKED", "RELATIVE"])
def test_the_materials_of_a_moved_result_are_corrected(folder, images):
    in_blender(check_result, folder, images)


def check_result(folder, images):
    addon = register()
    bpy, project = opened(folder)
    bpy.context.scene.nep.images, bpy.context.scene.nep.output = images, "//result"
    assert bpy.ops.nep.import_result() == {"FINISHED"} and bpy.context.scene.nep.asset == "//result"
    place = moved(bpy, project)
    settings = bpy.context.scene.nep
    assert addon.folders.resolve_folder(settings.asset) == place / "result"
    settings.materials[0].metal = "METAL"
    assert bpy.ops.nep.correct_materials() == {"FINISHED"}
    assert addon.tasks.registry.find(addon.tasks.material_correction.MaterialCorrection).is_seen, (
        "the images were read again"
    )
    settings.output = str(place / "result")
    assert bpy.ops.nep.import_result() == {"FINISHED"} and settings.asset == str(place / "result")


def test_the_objects_of_a_moved_shelf_are_in_the_scene(folder):
    in_blender(check_shelf, folder)


def check_shelf(folder):
    register()
    bpy, project = opened(folder)
    entries = [{"name": name, "capture": f"/captures/{name}"} for name in ("ant", "bee")]
    for entry in entries:
        shutil.copytree(folder / "asset", project / "shelf" / entry["name"])
    write_batch(project / "shelf", entries[:1])
    bpy.context.scene.nep.shelf_output = "//shelf"
    assert bpy.ops.nep.bring_in_objects() == {"FINISHED"}
    place = moved(bpy, project)
    assert bpy.ops.nep.bring_in_objects() == {"FINISHED"} and list(bpy.data.objects.keys()) == ["ant"]
    write_batch(place / "shelf", entries)
    assert bpy.ops.nep.bring_in_objects() == {"FINISHED"} and list(bpy.data.objects.keys()) == ["ant", "bee"]
    assert list(bpy.data.collections.keys()) == ["Shelf: shelf"] and len(bpy.data.collections[0].objects) == 2
    assert bpy.ops.nep.add_asset_library() == {"FINISHED"}
    with bpy.data.libraries.load(str(place / "shelf" / "shelf.blend"), assets_only=True) as (there, _):
        assert sorted(there.objects) == ["ant", "bee"]
    report = place / "shelf" / "ant" / "report.json"
    report.write_text(json.dumps(json.loads(report.read_text()) | {"seed": 1}))
    item = bpy.data.objects["ant"]
    assert bpy.ops.nep.bring_in_objects() == {"FINISHED"} and len(bpy.data.objects) == 2
    assert Path(item["nep_shelf_asset"]) == place / "shelf" / "ant", "it was made anew, and is known by its new place"


if __name__ == "__main__":
    function, place, *more = sys.argv[1:]
    sys.path.insert(0, str(Path(place) / "package"))
    globals()[function](Path(place), *more)
