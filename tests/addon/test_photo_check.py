"""Check Photos in Blender, with an engine that only plays it; and Improve Cameras. Each check is a process of its own."""

import json
import os
import sys
from pathlib import Path

import numpy as np
import pytest

from support import camera_engine, info_engine
from support.blender_checks import drawn_by, fails, register, rounds, told_in
from support.own_process import in_blender


@pytest.fixture
def folder(package, monkeypatch):
    """A folder with `photos`, which have cameras, and an engine, from which the add-on can be imported."""
    monkeypatch.setenv("NEP_ENGINE_PYTHON", make_place(package))
    return package


def make_place(folder: Path) -> str:
    """Write `photos`, which have cameras, and an engine into a folder; returns the engine's path."""
    camera_engine.write_photos(folder / "photos")
    (folder / "photos" / "transforms.json").write_text(json.dumps(camera_engine.cameras()))
    return info_engine.make(folder)


def set_up(folder: Path):
    """A new file whose scene names the photos; (bpy, the add-on's modules, settings)."""
    import bpy

    addon = register()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    settings = bpy.context.scene.nep
    settings.capture = str(folder / "photos")
    return bpy, addon, settings


def panel(bpy, addon) -> list[str]:
    return drawn_by(bpy, addon.panels.subpanels.NEP_PT_cameras_and_bounds)


def told(bpy, addon) -> str:
    """The same as one text: the panel breaks sentences into lines."""
    return " ".join(panel(bpy, addon))


def begin(folder: Path, addon):
    """Begin a check as the button does, which does not wait for its end."""
    check = addon.tasks.photo_check.PhotoCheck(folder / "photos", os.environ["NEP_ENGINE_PYTHON"], ())
    return addon.tasks.registry.start(check)


def test_the_panel_shows_what_the_engine_finds(folder):
    in_blender(check_result, folder)


def check_result(folder):
    bpy, addon, settings = set_up(folder)
    assert "nep.check_photos" in panel(bpy, addon) and not bpy.ops.nep.show_coverage.poll()
    assert bpy.ops.nep.check_photos() == {"FINISHED"}
    texts = panel(bpy, addon)
    for text in (
        *("From Above", "From Below", "Yellow to red: photos are missing.", "6 photos of 48 x 32 pixels"),
        *("41 % of all directions are near a photo", "within 70 degrees of straight below", "31 pixels wide"),
        *("up to 1.3 stops apart", "1 photo is clearly more blurred", "photo_3.jpg", "Too many moons"),
    ):
        assert text in told(bpy, addon), text
    assert "nep.show_coverage" in texts and "Nothing looks wrong" not in texts
    above, below = addon.halved_pictures.picture_halves(addon.tasks.photo_check.PICTURE)
    for half, color in ((above, [1, 0, 0, 1]), (below, [0, 1, 0, 1])):
        assert tuple(half.image_size) == (50, 39), "title and legend are cut off"
        pixels = np.array(half.image_pixels_float).reshape(39, 50, 4)
        np.testing.assert_allclose(pixels[4:], np.broadcast_to(color, (35, 50, 4)), atol=0.01)

    for _ in range(2):
        assert bpy.ops.nep.show_coverage() == {"FINISHED"}
    (image,) = bpy.data.images
    assert tuple(image.size) == (100, 50) and image.packed_file, "its file will vanish"
    well = info_engine.FOUND | {"warnings": []}
    (folder / "found.json").write_text(json.dumps(well))
    assert bpy.ops.nep.propose_bounds() == {"FINISHED"}  # the sphere of transforms.json: no engine
    settings.bounds.location.x = 2
    assert bpy.ops.nep.check_photos() == {"FINISHED"} and "Nothing looks wrong" in panel(bpy, addon)
    given = json.loads((folder / "info_arguments.json").read_text())
    assert given[-6:] == ["--object-center", "2.0", "0.0", "0.0", "--object-radius", "1.0"], "the artist's bounds count"


def test_a_result_is_forgotten_with_its_folder(folder):
    in_blender(check_forgetting, folder)


def check_forgetting(folder):
    bpy, addon, settings = set_up(folder)
    fact = "41 % of all directions are near a photo"
    assert bpy.ops.nep.check_photos() == {"FINISHED"} and fact in told(bpy, addon)
    picture = addon.tasks.photo_check.last_check(folder / "photos").picture
    settings.capture = str(camera_engine.write_photos(folder / "others"))
    assert fact not in told(bpy, addon) and not picture.exists()
    fails(bpy.ops.nep.check_photos, "press Find Cameras first")
    settings.capture = str(folder / "photos")
    assert fact not in told(bpy, addon)

    assert bpy.ops.nep.check_photos() == {"FINISHED"} and fact in told(bpy, addon)
    other = bpy.data.scenes.new("other")
    other.nep.capture = str(folder / "others")
    assert fact in told(bpy, addon), "this scene still names the folder"
    other.nep.capture = str(folder / "photos")
    settings.capture = str(folder / "others")
    assert addon.tasks.photo_check.last_check(folder / "photos") is not None, "the other scene still names it"
    bpy.data.scenes.remove(other)
    settings.capture = str(folder / "photos")

    assert bpy.ops.nep.check_photos() == {"FINISHED"} and fact in told(bpy, addon)
    (folder / "photos" / "photo_0.jpg").unlink()
    addon.capture_folder.forget_looks()
    assert fact not in told(bpy, addon), "the photos are others now"
    assert bpy.ops.nep.check_photos() == {"FINISHED"} and fact in told(bpy, addon)
    os.utime(folder / "photos" / "transforms.json", (1, 1))
    addon.capture_folder.forget_looks()
    assert fact not in told(bpy, addon), "the cameras are others now"


def test_a_check_runs_beside_blender_and_can_be_cancelled(folder):
    (folder / "info_mode").write_text("slow")
    in_blender(check_beside, folder)


def check_beside(folder):
    bpy, addon, settings = set_up(folder)
    for end in (bpy.ops.nep.cancel_check_photos, lambda: setattr(settings, "capture", str(folder / "none"))):
        check = begin(folder, addon)
        rounds(addon, (folder / "info_arguments.json").exists)
        texts = panel(bpy, addon)
        assert "Looking at the photos..." in texts and "nep.cancel_check_photos" in texts
        assert "nep.check_photos" not in texts and not bpy.ops.nep.check_photos.poll()
        end()
        assert "nep.check_photos" in panel(bpy, addon) and not bpy.ops.nep.cancel_check_photos.poll()
        rounds(addon, check.poll)
        addon.tasks.clock.tick()
        settings.capture = str(folder / "photos")
        assert addon.tasks.photo_check.last_check(folder / "photos") is None
    check = begin(folder, addon)
    (folder / "go").touch()
    rounds(addon, lambda: check.ended)
    assert "41 % of all directions are near a photo" in told(bpy, addon)


def test_what_the_engine_refuses_is_told(folder):
    in_blender(check_failures, folder)


def check_failures(folder):
    refusals = {
        "fail": ("Photo_3.jpg is torn", "Take photo_3.jpg out of the folder"),
        "old": ("older than this add-on", "Install the engine"),
    }
    for mode, refusal in refusals.items():
        with told_in(mode):
            os.environ["NEP_ENGINE_PYTHON"] = make_place(folder / mode)
            check_failure(folder / mode, mode, *refusal)


def check_failure(folder, mode, message, hint):
    (folder / "info_mode").write_text(mode)
    bpy, addon, _settings = set_up(folder)
    fails(bpy.ops.nep.check_photos, message)
    texts = panel(bpy, addon)
    assert message in told(bpy, addon) and hint in told(bpy, addon) and ("nep.open_preferences" in texts) == (mode == "old")
    path = folder / "photos" / "transforms.json"
    without = json.loads(path.read_text())
    del without["object_center"], without["object_radius"]
    path.write_text(json.dumps(without))
    addon.capture_folder.forget_looks()
    fails(bpy.ops.nep.propose_bounds, message)
    assert told(bpy, addon).count(message) == 1, "the check was of other cameras"
    (folder / "info_mode").write_text("well")
    assert bpy.ops.nep.propose_bounds() == {"FINISHED"} and message not in told(bpy, addon)
    given = addon.scene.object_bounds.bounds_arguments(bpy.context.scene)
    np.testing.assert_allclose([float(number) for number in (*given[1:4], given[5])], [0.1, 0.2, 0.3, 0.7], atol=1e-6)


def test_cameras_that_are_there_can_be_improved(folder, monkeypatch):
    monkeypatch.setenv("NEP_ENGINE_PYTHON", camera_engine.make(folder))
    (folder / "mode").write_text("improve")
    in_blender(check_improving, folder)


def check_improving(folder):
    bpy, addon, settings = set_up(folder)
    texts = panel(bpy, addon)
    assert "nep.improve_cameras" in texts and "Find Cameras Again" in texts
    assert bpy.ops.nep.improve_cameras() == {"FINISHED"}
    assert json.loads((folder / "arguments.json").read_text()) == ["--watch-stdin", "--improve", "--overwrite"]
    main = " ".join(drawn_by(bpy, addon.panels.reconstruct.NEP_PT_reconstruct))
    assert "The cameras were improved" in main and "Press Load Cameras again" in main and "Propose Bounds again" not in main
    (folder / "photos" / "masks").mkdir()
    (folder / "photos" / "masks" / "photo_0.png").touch()
    settings.features = "surroundings"
    assert bpy.ops.nep.improve_cameras() == {"FINISHED"}
    options = json.loads((folder / "arguments.json").read_text())
    assert options == ["--watch-stdin", "--features", "surroundings", "--improve", "--overwrite"]
    (folder / "photos" / "transforms.json").unlink()
    addon.capture_folder.forget_looks()
    assert not bpy.ops.nep.improve_cameras.poll() and "nep.improve_cameras" not in panel(bpy, addon)
    bpy.ops.nep.find_cameras()
    assert json.loads((folder / "arguments.json").read_text()) == ["--watch-stdin", "--features", "surroundings"]


if __name__ == "__main__":
    sys.path.insert(0, str(Path(sys.argv[2]) / "package"))
    globals()[sys.argv[1]](Path(sys.argv[2]), *sys.argv[3:])
