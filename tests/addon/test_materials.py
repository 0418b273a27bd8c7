"""The correction of materials in Blender, with an engine that only plays it. Each check is a process."""

import json
import os
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from support import correcting_engine
from support.blender_checks import Drawn, drawn_by, fails, register, rounds, told_in
from support.own_process import in_blender
from support.played_python import bare_python


@pytest.fixture
def folder(package, monkeypatch):
    """A folder with `asset` and an engine, from which the add-on can be imported."""
    correcting_engine.make_asset(package / "asset")
    monkeypatch.setenv("NEP_ENGINE_PYTHON", correcting_engine.make(package))
    return package


def imported(folder: Path, images: str = "PACKED"):
    """A new file into which the asset was imported; (bpy, the add-on's modules, settings)."""
    import bpy

    addon = register()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    settings = bpy.context.scene.nep
    settings.images = images
    assert bpy.ops.nep.import_result(folder=str(folder / "asset")) == {"FINISHED"}
    return bpy, addon, settings


def given(folder: Path) -> list[str]:
    """What the engine was asked for last."""
    return json.loads((folder / "arguments.json").read_text())


def texels(bpy, name: str) -> list[float]:
    """The values of an imported texture, one for each material."""
    image = bpy.data.objects["asset"].data.materials[0].node_tree.nodes[name].image
    pixels = np.empty(8 * 3 * 4, np.float32)
    image.pixels.foreach_get(pixels)
    return np.round(pixels.astype(float).reshape(8, 3, 4)[0, :, 0], 2).tolist()


def panel(bpy, addon) -> list[str]:
    return drawn_by(bpy, addon.panels.materials.NEP_PT_materials)


class DrawnRow(Drawn):
    """Notes the icon behind each text."""

    def __getattr__(self, name: str):
        def note(*_arguments, text="", icon="NONE", **_keywords):
            self.log += [f"{text} {icon}".removesuffix(" NONE")] if name == "label" else []
            return DrawnRow(self.log)

        return note


def rows(addon, settings) -> list[str]:
    """The list as it is drawn."""
    layout = DrawnRow()
    for item in settings.materials:
        addon.panels.materials.NEP_UL_materials.draw_item(None, None, layout, settings, item, 0, settings)
    return layout.log


def test_an_import_lists_the_materials_and_their_corrections(folder):
    in_blender(check_list, folder)


def check_list(folder):
    bpy, addon, settings = imported(folder)
    assert rows(addon, settings) == ["62 %", "0.50", "No", "30 %", "0.10", "Yes", "8 %", "0.30", "No"]
    np.testing.assert_allclose(settings.materials[1].albedo, [0.9, 0.7, 0.3], atol=1e-6)
    assert "Not applied yet" not in panel(bpy, addon) and "nep.correct_materials" in panel(bpy, addon)
    assert all(item.metal == "AS_LEARNED" and not item.set_roughness for item in settings.materials)
    assert [round(item.new_roughness, 4) for item in settings.materials] == [0.5, 0.1, 0.3], "where a correction begins"

    corrections = {"0": {"roughness": 0.25}, "1": {"metallic": 0}}
    many = (correcting_engine.MATERIALS * 4)[:12]
    many[0] = many[0] | {"share": 0.001}
    correcting_engine.write_report(folder / "asset", many, corrections)
    settings.material_index = 2
    assert bpy.ops.nep.import_result(folder=str(folder / "asset")) == {"FINISHED"}
    assert len(settings.materials) == 12 and settings.material_index == 2
    assert rows(addon, settings)[:6] == ["< 1 %", "0.25 GREASEPENCIL", "No", "30 %", "0.10", "No GREASEPENCIL"]
    assert settings.materials[0].set_roughness and settings.materials[1].metal == "NOT_METAL"
    assert "Not applied yet" not in panel(bpy, addon), "the textures have them"
    settings.material_index = 11
    correcting_engine.write_report(folder / "asset", correcting_engine.MATERIALS)
    assert bpy.ops.nep.import_result(folder=str(folder / "asset")) == {"FINISHED"}
    assert settings.material_index == 2 and not any(item.set_roughness for item in settings.materials)
    assert "Learned: roughness 0.30, not metal" in " ".join(panel(bpy, addon))


@pytest.mark.parametrize("images", ["PACKED", "RELATIVE"])
def test_a_correction_changes_textures_and_a_reset_restores_them(folder, images):
    in_blender(check_correction, folder, images)


def check_correction(folder, images):
    bpy, addon, settings = imported(folder, images)
    item = bpy.data.objects["asset"]
    nodes = item.data.materials[0].node_tree.nodes
    blocks = {name: nodes[name].image for name in ("albedo", "roughness", "metallic", "confidence")}
    own = bpy.data.materials.new("own")
    if not own.use_nodes:
        own.use_nodes = True
    own.node_tree.nodes.new("ShaderNodeTexImage").image = blocks["roughness"]
    confidence = [point.value for point in item.data.attributes["confidence"].data]
    assert texels(bpy, "roughness") == [0.5, 0.1, 0.3] and texels(bpy, "metallic") == [0, 1, 0]

    third = settings.materials[2]
    third.metal, third.set_roughness, third.new_roughness = "METAL", True, 0.2
    settings.materials[1].new_roughness = 0.9  # its box is not ticked
    assert rows(addon, settings)[6:] == ["8 %", "0.20 GREASEPENCIL", "Yes GREASEPENCIL"]
    assert bpy.ops.nep.correct_materials() == {"FINISHED"}
    assert given(folder) == ["--set", "2:metallic=1", "--set", "2:roughness=0.2"]
    assert texels(bpy, "roughness") == [0.5, 0.1, 0.2] and texels(bpy, "metallic") == [0, 1, 1]
    assert {name: nodes[name].image for name in blocks} == blocks and len(bpy.data.images) == 5
    assert all(bool(image.packed_file) == (images == "PACKED") for image in blocks.values())
    assert [point.value for point in item.data.attributes["confidence"].data] == confidence
    assert rows(addon, settings)[6:] == ["8 %", "0.20 GREASEPENCIL", "Yes GREASEPENCIL"]
    assert "Not applied yet" not in panel(bpy, addon) and "The light is weak" in panel(bpy, addon)

    settings.materials[0].metal = "METAL"
    settings.materials[2].metal = "AS_LEARNED"
    assert bpy.ops.nep.correct_materials() == {"FINISHED"}
    assert given(folder) == ["--set", "0:metallic=1", "--set", "2:roughness=0.2"]
    assert texels(bpy, "metallic") == [1, 1, 0]
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "scene.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(folder / "scene.blend"))
    settings = bpy.context.scene.nep
    assert texels(bpy, "metallic") == [1, 1, 0] and texels(bpy, "roughness") == [0.5, 0.1, 0.2]
    assert rows(addon, settings) == "62 %|0.50|Yes GREASEPENCIL|30 %|0.10|Yes|8 %|0.20 GREASEPENCIL|No".split("|")

    assert bpy.ops.nep.correct_materials(reset=True) == {"FINISHED"} and given(folder) == ["--reset"]
    assert texels(bpy, "metallic") == [0, 1, 0] and texels(bpy, "roughness") == [0.5, 0.1, 0.3]
    assert rows(addon, settings) == ["62 %", "0.50", "No", "30 %", "0.10", "Yes", "8 %", "0.30", "No"]
    assert bpy.ops.nep.correct_materials() == {"FINISHED"} and given(folder) == ["--reset"], "nothing is chosen"


def test_a_correction_runs_beside_blender(folder):
    in_blender(check_beside, folder)


def check_beside(folder):
    bpy, addon, settings = imported(folder)
    (folder / "mode").write_text("slow")
    settings.materials[0].metal = "METAL"
    start = addon.tasks.material_correction.start_correction
    chosen = addon.scene.imported_materials.chosen_corrections(settings)
    start(os.environ["NEP_ENGINE_PYTHON"], folder / "asset", chosen, wait=False)
    rounds(addon, lambda: "50 %" in panel(bpy, addon))
    assert "Learning the materials" in panel(bpy, addon) and "nep.correct_materials" not in panel(bpy, addon)
    assert not bpy.ops.nep.correct_materials.poll()
    settings.capture, settings.output = str(folder), str(folder / "asset")
    from blender_nep.job.folders.job_folder import held

    with held(folder / "asset"):  # as the engine does while it corrects; the played one does not
        fails(lambda: bpy.ops.nep.reconstruct(overwrite=True), "are being corrected")
    assert bpy.ops.nep.import_result() == {"FINISHED"}, "a second object of the result"
    second = bpy.data.objects["asset.001"].data.materials[0].node_tree.nodes["metallic"].image
    (folder / "go").touch()
    rounds(addon, bpy.ops.nep.correct_materials.poll)
    assert texels(bpy, "metallic") == [1, 1, 0] and second.pixels[0] == 1 and addon.tasks.clock.tick() is None
    assert settings.materials[0].metal == "METAL" and "nep.correct_materials" in panel(bpy, addon)

    (folder / "go").unlink()
    second_correction = start(os.environ["NEP_ENGINE_PYTHON"], folder / "asset", {}, wait=False)
    bpy.ops.wm.read_factory_settings(use_empty=True)  # File > New, in the middle
    (folder / "go").touch()
    rounds(addon, lambda: second_correction.ended)
    assert not bpy.context.scene.nep.materials and not bpy.ops.nep.correct_materials.poll()
    assert "Import a result first: its materials" in panel(bpy, addon)[0]


def test_undo_keeps_the_file_as_the_folder_is(folder):
    in_blender(check_undo, folder)


def check_undo(folder):
    bpy, addon, settings = imported(folder)
    bpy.ops.ed.undo_push(message="before")
    settings.materials[0].metal = "METAL"
    bpy.ops.ed.undo_push(message="chosen")
    assert bpy.ops.nep.correct_materials() == {"FINISHED"}
    bpy.context.scene.nep.materials[2].metal = "METAL"
    bpy.ops.ed.undo_push(message="chosen, too")
    assert bpy.ops.ed.undo() == {"FINISHED"}
    for step in (bpy.ops.ed.undo, bpy.ops.ed.redo, bpy.ops.ed.redo):
        materials = bpy.context.scene.nep.materials
        assert materials[0].metal == "METAL" and addon.scene.imported_materials.applied_correction(materials[0])
        assert texels(bpy, "metallic") == [1, 1, 0]
        step()
    assert bpy.context.scene.nep.materials[2].metal == "METAL", "what is chosen but not applied is undone and redone as ever"
    bpy.ops.ed.undo()
    bpy.ops.ed.undo()
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "scene.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(folder / "scene.blend"))
    assert texels(bpy, "metallic") == [1, 1, 0], "the packed pixels are those that were shown"


def test_what_the_engine_refuses_is_told_and_nothing_is_lost(folder):
    in_blender(check_failures, folder)


def check_failures(folder):
    refusals = {
        "refuse": ("The light was not kept", "Reconstruct again."),
        "crash": ("The engine was killed", "Press Apply again."),
        "old": ("The installed engine is older", "Install the engine"),
    }
    for mode, told in refusals.items():
        with told_in(mode):
            check_failure(new_place(folder, mode), mode, *told)


def new_place(folder: Path, name: str) -> Path:
    """A folder in `folder` with an asset and an engine of its own, which Blender starts from now on."""
    correcting_engine.make_asset(folder / name / "asset")
    os.environ["NEP_ENGINE_PYTHON"] = correcting_engine.make(folder / name)
    return folder / name


def check_failure(folder, mode, message, hint):
    (folder / "mode").write_text(mode)
    bpy, addon, settings = imported(folder)
    settings.materials[0].metal = "METAL"
    for reset in (False, True):
        fails(lambda reset=reset: bpy.ops.nep.correct_materials(reset=reset), message)
        texts = " ".join(panel(bpy, addon))
        assert message in texts and hint in texts and ("nep.open_preferences" in texts) == (mode == "old")
        assert "Not applied yet" in texts and settings.materials[0].metal == "METAL", "it can be applied again"
        assert texels(bpy, "metallic") == [0, 1, 0]
    (folder / "mode").write_text("well")
    assert bpy.ops.nep.correct_materials() == {"FINISHED"} and message not in " ".join(panel(bpy, addon))


def test_a_correction_that_cannot_start_says_what_to_do(folder):
    in_blender(check_no_start, folder)


def check_no_start(folder):
    bpy, addon, settings = imported(folder)
    asset = folder / "asset"

    def refused(message: str, hint: str) -> None:
        fails(bpy.ops.nep.correct_materials, message)
        texts = " ".join(panel(bpy, addon)).replace(" ", "")  # a long path is broken into lines
        assert message.replace(" ", "") in texts and hint.replace(" ", "") in texts
        assert not (folder / "arguments.json").exists(), "no engine was started"

    engine = os.environ["NEP_ENGINE_PYTHON"]
    os.environ["NEP_ENGINE_PYTHON"] = bare_python(folder)
    refused("lacks blender_nep", "Install the engine")
    os.environ["NEP_ENGINE_PYTHON"] = str(folder / "no-python")
    refused("cannot be started", "Install the engine")
    os.environ["NEP_ENGINE_PYTHON"] = engine
    from blender_nep.job.folders.job_folder import JobFolder

    job = JobFolder(asset, followed=True)  # as another program that works in the folder
    refused("The engine is at work in", "Wait for its end")
    os.close(job._lock)
    correcting_engine.write_report(asset, correcting_engine.MATERIALS[:2])
    refused("holds another result by now", "Import it")
    correcting_engine.write_report(asset, correcting_engine.MATERIALS)
    (asset / "checkpoints").mkdir()
    (asset / "checkpoints" / "run.json").touch()
    (asset / "report.json").rename(folder / "report.json")
    refused("There is no finished result", "Its job has not ended: Resume it.")
    (folder / "report.json").rename(asset / "report.json")
    asset.rename(folder / "moved")
    refused("There is no finished result", "Bring the folder back")
    settings.asset = "//asset"
    fails(bpy.ops.nep.correct_materials, "Save the file first")
    settings.asset = str(asset)
    (folder / "moved").rename(asset)
    assert bpy.ops.nep.correct_materials() == {"FINISHED"}


def test_moved_textureless_and_older_results_are_told_or_shown(folder):
    in_blender(check_unusual_files, folder)


def check_unusual_files(folder):
    for check in (check_moved, check_no_images, check_older):
        with told_in(check.__name__):
            check(new_place(folder, check.__name__))


def check_moved(folder):
    """Saving makes the paths of packed images relative, so that they lead nowhere in another folder."""
    bpy, addon, settings = imported(folder)
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "scene.blend"))
    (folder / "far" / "away").mkdir(parents=True)
    shutil.move(folder / "scene.blend", folder / "far" / "away" / "scene.blend")
    bpy.ops.wm.open_mainfile(filepath=str(folder / "far" / "away" / "scene.blend"))
    settings = bpy.context.scene.nep
    settings.materials[0].metal = "METAL"
    assert bpy.ops.nep.correct_materials() == {"FINISHED"}
    assert texels(bpy, "metallic") == [1, 1, 0]
    assert "Import the result again" not in " ".join(panel(bpy, addon))


def check_no_images(folder):
    """The object's textures are gone from the file."""
    bpy, addon, settings = imported(folder)
    bpy.data.batch_remove(list(bpy.data.images))
    settings.materials[0].metal = "METAL"
    assert bpy.ops.nep.correct_materials() == {"FINISHED"}
    assert "Import the result again to see the correction." in " ".join(panel(bpy, addon))


def check_older(folder):
    (folder / "asset" / "report.json").write_text('{"preset": "preview"}')
    bpy, addon, settings = imported(folder)
    assert not settings.materials and not bpy.ops.nep.correct_materials.poll()
    assert "an older version of the engine has made it" in " ".join(panel(bpy, addon))
    correcting_engine.write_report(folder / "asset", correcting_engine.MATERIALS)
    assert bpy.ops.nep.import_result(folder=str(folder / "asset")) == {"FINISHED"} and bpy.ops.nep.correct_materials.poll()
    shutil.copytree(folder / "asset", folder / "older")
    (folder / "older" / "report.json").write_text("{}")
    assert bpy.ops.nep.import_result(folder=str(folder / "older")) == {"FINISHED"}
    assert not settings.materials, "nothing is left of the result before"


if __name__ == "__main__":
    sys.path.insert(0, str(Path(sys.argv[2]) / "package"))
    globals()[sys.argv[1]](Path(sys.argv[2]), *sys.argv[3:])
