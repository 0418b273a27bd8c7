"""What follows from the choice of a capture folder. One session."""

import json
import shutil
import sys
from pathlib import Path

from support import correcting_engine
from support.blender_checks import drawn_by, fails, register
from support.own_process import in_blender


def test_the_choice_of_a_capture(package, make_capture):
    make_capture(masks=True)
    in_blender(check_choice, package)


def check_choice(folder):
    import bpy

    addon = register()
    settings = bpy.context.scene.nep

    def texts() -> list[str]:
        return drawn_by(bpy, addon.panels.reconstruct.NEP_PT_reconstruct)

    def chosen() -> tuple[str, str]:
        return settings.capture, settings.output

    settings.capture = str(folder / "capture")
    assert settings.output == str(folder / "capture_result")
    assert "6 photos, cameras, masks" in texts()
    settings.capture = str(folder / "capture" / "images") + "/"  # as the file browser gives it
    assert chosen() == (str(folder / "capture"), str(folder / "capture_result"))
    shutil.copytree(folder / "capture" / "images", folder / "images")
    settings.capture = str(folder / "images")  # no capture is above it
    assert chosen() == (str(folder / "images"), str(folder / "images_result"))
    assert "6 photos, no cameras yet" in texts()
    settings.output = str(folder / "my own")
    settings.capture = str(folder / "capture")
    assert settings.output == str(folder / "my own"), "the artist's choice stays"
    report = folder / "my own" / "report.json"
    report.parent.mkdir()
    for made_of, kept in (
        (str(folder / "capture"), True),
        (str(folder / "moved"), True),
        (f"/{folder / 'images'}", True),  # it begins with two slashes, as folders of other computers do
        (7, True),
        (str(folder / "images"), False),
    ):
        report.write_text(json.dumps({"capture": {"folder": made_of}}))
        settings.output = str(folder / "my own")
        settings.capture = str(folder / "capture")
        assert settings.output == str(folder / ("my own" if kept else "capture_result")), "the result of other photos"
    settings.output = settings.capture = ""
    assert chosen() == ("", "")

    (folder / "work").mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "work" / "scene.blend"))
    shutil.copytree(folder / "capture", folder / "work" / "pot")
    settings.capture = "//pot/images/"
    assert chosen() == ("//pot", "//pot_result")
    settings.capture = "//pot"
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "scene.blend"))
    assert chosen() == ("//work/pot", "//work/pot_result")
    settings.capture = "//capture"
    assert chosen() == ("//capture", "//capture_result"), "a proposed folder goes along also after Save As"
    for unusable in ("/", str(folder / "none")):
        settings.output = ""
        settings.capture = unusable
        assert settings.output == ("" if unusable == "/" else str(folder / "none_result"))

    choose = bpy.ops.nep.choose_folder
    settings.output = settings.capture = ""
    fails(choose, "Choose a folder")
    fails(lambda: choose(directory=str(folder / "package" / "none")), "neither photos nor a finished result")
    for given in ({"directory": str(folder / "capture" / "images")}, {"filepath": str(folder / "capture/transforms.json")}):
        assert choose(**given) == {"FINISHED"} and chosen() == (str(folder / "capture"), str(folder / "capture_result"))
    settings.output = settings.capture = ""
    bpy.ops.ed.undo_push(message="before")
    choose("EXEC_DEFAULT", True, directory=str(folder / "capture"))
    bpy.ops.object.camera_add("EXEC_DEFAULT", True)
    bpy.ops.ed.undo()
    settings = bpy.context.scene.nep
    assert settings.capture == str(folder / "capture"), "the next step alone is undone"
    correcting_engine.make_asset(folder / "asset")
    assert choose(filepath=str(folder / "asset" / "report.json")) == {"FINISHED"}
    assert "asset" in bpy.data.objects and settings.capture == str(folder / "capture")
    menus = addon.panels.menus
    for menu, draw in menus._places():
        assert draw in menu._dyn_ui_initialize()


if __name__ == "__main__":
    sys.path.insert(0, str(Path(sys.argv[2]) / "package"))
    globals()[sys.argv[1]](Path(sys.argv[2]))
