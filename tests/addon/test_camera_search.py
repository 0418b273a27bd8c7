"""The search for the cameras of photos in Blender, with an engine that only plays it. Each check is a process."""

import contextlib
import io
import json
import os
import sys
from pathlib import Path

import numpy as np
import pytest

from support import camera_engine
from support.blender_checks import drawn_by, fails, register, rounds, told_in
from support.own_process import in_blender


@pytest.fixture
def folder(package, monkeypatch):
    """A folder with `photos` and an engine, from which the add-on can be imported."""
    camera_engine.write_photos(package / "photos")
    monkeypatch.setenv("NEP_ENGINE_PYTHON", camera_engine.make(package))
    return package


def set_up(folder: Path):
    """A new file whose scene names the photos and an output folder; (bpy, the add-on's modules, settings)."""
    import bpy

    addon = register()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    settings = bpy.context.scene.nep
    settings.capture, settings.output = str(folder / "photos"), str(folder / "out")
    return bpy, addon, settings


def begin(folder: Path, addon):
    """Begin a search as the button does, which does not wait for its end."""
    python = os.environ["NEP_ENGINE_PYTHON"]
    return addon.tasks.camera_search.start_search(python, folder / "photos", threads=None, replace=False, wait=False)


def panel(bpy, addon) -> list[str]:
    return drawn_by(bpy, addon.panels.reconstruct.NEP_PT_reconstruct)


def cameras_panel(bpy, addon) -> list[str]:
    return drawn_by(bpy, addon.panels.subpanels.NEP_PT_cameras_and_bounds)


def test_photos_without_cameras_get_them_and_are_a_capture_then(folder):
    in_blender(check_search, folder)


def check_search(folder):
    bpy, addon, settings = set_up(folder)
    assert "6 photos, no cameras yet" in panel(bpy, addon) and "nep.find_cameras" in panel(bpy, addon)
    assert "nep.find_cameras" not in cameras_panel(bpy, addon), "nothing can be replaced"
    for refused in (bpy.ops.nep.reconstruct, bpy.ops.nep.load_cameras, bpy.ops.nep.propose_bounds):
        fails(refused, f"{folder / 'photos'} holds photos, but no cameras yet: press Find Cameras first")
    settings.threads = 2
    assert bpy.ops.nep.find_cameras() == {"FINISHED"}
    assert json.loads((folder / "arguments.json").read_text()) == ["--watch-stdin", "--threads", "2"]
    texts = panel(bpy, addon)
    told = " ".join(texts)
    assert "5 of 6 photos were placed." in told and "1 photo was not placed" in told and "photo_5.jpg" in told
    assert "nep.find_cameras" not in texts and "no cameras yet" not in told and "nep.reconstruct" in texts
    assert "Find Cameras Again" in cameras_panel(bpy, addon)
    check_found_capture(bpy, addon)

    fails(bpy.ops.nep.find_cameras, "press Find Cameras Again")
    assert "has cameras already" in " ".join(panel(bpy, addon))
    (folder / "mode").write_text("sure")
    assert bpy.ops.nep.find_cameras(overwrite=True) == {"FINISHED"}
    told = " ".join(panel(bpy, addon))
    assert "6 of 6 photos" in told and "The cameras look right." in told and "Load Cameras and Propose Bounds again" in told
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.nep.capture = str(folder / "photos")
    assert "6 of 6 photos" not in " ".join(panel(bpy, addon))


def check_found_capture(bpy, addon):
    """The usual next steps: cameras with their photos, and bounds."""
    assert bpy.ops.nep.load_cameras() == {"FINISHED"}
    (collection,) = (c for c in bpy.context.scene.collection.children if c.name.startswith("NeP cameras"))
    assert sorted(item.name for item in collection.objects) == [f"photo_{n}" for n in range(5)]
    for item in collection.objects:
        background = item.data.background_images[0].image
        assert Path(bpy.path.abspath(background.filepath)).is_file() and tuple(background.size) == camera_engine.SIZE
    first = np.array(collection.objects["photo_0"].matrix_world)
    np.testing.assert_allclose(first, camera_engine.cameras()["frames"][0]["transform_matrix"], atol=1e-6)
    cube = bpy.data.objects.new("cube", None)
    bpy.context.scene.collection.objects.link(cube)
    cube.select_set(True)
    assert bpy.ops.nep.propose_bounds() == {"FINISHED"}
    layer = bpy.context.view_layer
    assert list(layer.objects.selected) == [layer.objects.active] == [bpy.context.scene.nep.bounds]
    given = addon.scene.object_bounds.bounds_arguments(bpy.context.scene)
    assert [float(number) for number in (*given[1:4], given[5])] == [0, 0, 0, 1]


def test_a_search_runs_beside_blender_and_can_be_cancelled(folder):
    (folder / "mode").write_text("slow")
    in_blender(check_beside, folder)


def check_beside(folder):
    bpy, addon, settings = set_up(folder)
    search = begin(folder, addon)
    rounds(addon, lambda: "25 %" in panel(bpy, addon))
    texts = panel(bpy, addon)
    assert {"Finding the cameras", "Looked for details in 3 of 6 photos", "about 1 min 20 s left"} <= set(texts)
    assert "nep.cancel_find_cameras" in texts and "nep.find_cameras" not in texts
    assert not bpy.ops.nep.find_cameras.poll()
    for refused in (bpy.ops.nep.reconstruct, bpy.ops.nep.load_cameras):
        fails(refused, "are being found")
    settings.capture = str(camera_engine.write_photos(folder / "others", 4))
    assert "4 photos, no cameras yet" in panel(bpy, addon) and "25 %" not in panel(bpy, addon)
    settings.capture = str(folder / "photos")
    assert bpy.ops.nep.cancel_find_cameras() == {"FINISHED"} and not bpy.ops.nep.cancel_find_cameras.poll()
    assert "Stopping" in panel(bpy, addon)
    rounds(addon, bpy.ops.nep.find_cameras.poll)
    assert json.loads((folder / "stopped").read_text()) == {"cmd": "stop"} and search.failed is not None
    assert addon.tasks.clock.tick() is None, "the timer rests"
    calls = []
    addon.tasks.clock.call_until_false(lambda: 1 / 0)
    addon.tasks.clock.call_until_false(lambda: len(calls) < 2 and not calls.append(0))
    with contextlib.redirect_stderr(io.StringIO()) as printed:
        assert addon.tasks.clock.tick() and addon.tasks.clock.tick() and addon.tasks.clock.tick() is None and len(calls) == 2
    assert printed.getvalue().count("ZeroDivisionError") == 1, "an error ends one task, and is told in the console"
    told = " ".join(panel(bpy, addon))
    assert "Stopped. No cameras were written" in told and "6 photos, no cameras yet" in told and "nep.find_cameras" in told
    assert not (folder / "photos" / "transforms.json").exists()

    search = begin(folder, addon)
    rounds(addon, lambda: "25 %" in panel(bpy, addon))
    bpy.ops.wm.read_factory_settings(use_empty=True)  # File > New, in the middle
    bpy.context.scene.nep.capture = str(folder / "photos")
    assert "25 %" in panel(bpy, addon)
    (folder / "go").touch()
    rounds(addon, lambda: search.ended)
    assert "5 of 6 photos were placed." in " ".join(panel(bpy, addon))


def test_closing_blender_ends_the_search(folder):
    (folder / "mode").write_text("slow")
    in_blender(check_close, folder)
    from support.waiting import wait_until

    wait_until(lambda: (folder / "stopped").exists() and (folder / "stopped").read_text())
    assert (folder / "stopped").read_text() == "closed" and not (folder / "photos" / "transforms.json").exists()


def check_close(folder):
    bpy, addon, _settings = set_up(folder)
    begin(folder, addon)
    rounds(addon, lambda: "25 %" in panel(bpy, addon))


def test_what_the_engine_refuses_is_told_with_what_to_do(folder):
    in_blender(check_failures, folder)


def check_failures(folder):
    refusals = {
        "fail": ("No photo could be placed", "Put the object on a sheet with a print"),
        "locked": ("may not be written (Permission denied)", "Change its permissions, or copy the photos"),
        "crash": ("The engine was killed", "Press the button again."),
        "old": ("The installed engine is older", "Install the engine"),
    }
    for mode, told in refusals.items():
        with told_in(mode):
            check_failure(new_place(folder, mode), mode, *told)


def new_place(folder: Path, name: str) -> Path:
    """A folder in `folder` with photos and an engine of its own, which Blender starts from now on."""
    place = folder / name
    camera_engine.write_photos(place / "photos")
    os.environ["NEP_ENGINE_PYTHON"] = camera_engine.make(place)
    return place


def check_failure(folder, mode, message, hint):
    (folder / "mode").write_text(mode)
    bpy, addon, _settings = set_up(folder)
    fails(bpy.ops.nep.find_cameras, message)
    texts = panel(bpy, addon)
    told = " ".join(texts)
    assert message in told and hint in told and ("nep.open_preferences" in texts) == (mode == "old")
    assert "6 photos, no cameras yet" in texts and "nep.find_cameras" in texts, "it can be pressed again"
    (folder / "mode").write_text("well")
    assert bpy.ops.nep.find_cameras() == {"FINISHED"} and message not in " ".join(panel(bpy, addon))


def test_a_search_that_cannot_start_says_what_to_do(folder):
    in_blender(check_no_start, folder)


def check_no_start(folder):
    import errno

    bpy, addon, settings = set_up(folder)
    engine = os.environ["NEP_ENGINE_PYTHON"]
    os.environ["NEP_ENGINE_PYTHON"] = str(folder / "no-python")
    fails(bpy.ops.nep.find_cameras, "cannot be started")
    assert "nep.open_preferences" in panel(bpy, addon)
    os.environ["NEP_ENGINE_PYTHON"] = engine

    from nep_addon.backend.engine.commands import camera_process

    def refused(**_):
        raise PermissionError(errno.EACCES, "Permission denied")

    files, camera_process.tempfile.TemporaryFile = camera_process.tempfile.TemporaryFile, refused
    fails(bpy.ops.nep.find_cameras, "may not be written (Permission denied)")
    assert "Change its permissions" in " ".join(panel(bpy, addon)) and not (folder / "arguments.json").exists()
    camera_process.tempfile.TemporaryFile = files
    settings.capture = "//photos"
    fails(bpy.ops.nep.find_cameras, "Save the file first")
    settings.capture = ""
    assert not bpy.ops.nep.find_cameras.poll()


def test_the_search_is_offered_only_where_it_helps(folder):
    in_blender(check_offers, folder)


def check_offers(folder):
    bpy, addon, settings = set_up(folder)
    camera_engine.write_photos(folder / "project" / "images", 3)
    settings.capture = str(folder / "project")
    assert "3 photos, no cameras yet" in panel(bpy, addon)
    for name in ("cameras.bin", "images.bin"):  # of COLMAP
        (folder / "project" / name).touch()
    addon.capture_folder.forget_looks()
    assert "nep.find_cameras" not in panel(bpy, addon) and "nep.find_cameras" not in cameras_panel(bpy, addon)
    settings.capture = str(camera_engine.write_photos(folder / "two", 2))
    assert "Too few photos: 2 of at least 3" in panel(bpy, addon) and "nep.find_cameras" not in panel(bpy, addon)
    settings.capture = str(camera_engine.write_photos(folder / "empty", 0))
    assert "This folder holds no photos" in " ".join(panel(bpy, addon))
    settings.capture = str(folder / "none")
    assert not [text for text in panel(bpy, addon) if "photos" in text and "small photos" not in text]


def test_the_frames_of_a_video_are_searched(folder):
    in_blender(check_video, folder)


def check_video(folder):
    bpy, addon, settings = set_up(folder)
    film = folder / "films" / "walk.MP4"
    film.parent.mkdir()
    film.touch()
    settings.capture = ""
    assert "nep.find_cameras_of_video" in panel(bpy, addon)
    fails(lambda: bpy.ops.nep.find_cameras_of_video(filepath=str(folder / "photos" / "photo_0.jpg")), "Choose a video")
    fails(lambda: bpy.ops.nep.find_cameras_of_video(), "Choose a video")
    assert settings.capture == ""
    assert bpy.ops.nep.find_cameras_of_video(filepath=str(film), frames=40) == {"FINISHED"}
    given = json.loads((folder / "arguments.json").read_text())
    assert given == ["--watch-stdin", "--out", str(folder / "films" / "walk"), "--frames", "40"]
    assert settings.capture == str(folder / "films" / "walk")
    assert "5 of 6 photos were placed." in " ".join(panel(bpy, addon))
    fails(lambda: bpy.ops.nep.find_cameras_of_video(filepath=str(film)), "press Find Cameras Again")
    (folder / "films" / "walk" / "masks").mkdir()
    (folder / "films" / "walk" / "masks" / "frame_0.png").touch()
    addon.capture_folder.forget_looks()
    settings.features = "object"
    assert bpy.ops.nep.find_cameras_of_video(filepath=str(film), overwrite=True) == {"FINISHED"}
    given = json.loads((folder / "arguments.json").read_text())
    assert "--overwrite" in given and "--features" not in given, "new frames have no masks yet"


def test_a_folder_with_a_video_offers_the_search(folder):
    in_blender(check_video_folder, folder)


def check_video_folder(folder):
    bpy, addon, settings = set_up(folder)
    films = folder / "films"
    films.mkdir()
    (films / "walk.mov").touch()
    settings.capture = str(films)
    texts = panel(bpy, addon)
    assert "A video, no photos yet" in texts and "nep.find_cameras" in texts and "This folder holds no photos" not in texts
    (films / "walk.jpg").touch()
    addon.capture_folder.forget_looks()
    texts = panel(bpy, addon)
    assert "A video, no photos yet" in texts and "nep.find_cameras" in texts, "a picture of the phone lies beside it"
    (films / "second.mov").touch()
    addon.capture_folder.forget_looks()
    texts = panel(bpy, addon)
    assert "2 videos, no photos yet" in texts and "nep.find_cameras" not in texts and "nep.find_cameras_of_video" in texts


def test_a_look_into_a_folder_is_kept_longer_on_a_slow_drive(folder):
    in_blender(check_kept_looks, folder)


def check_kept_looks(folder):
    _bpy, addon, _settings = set_up(folder)
    photos, now = folder / "photos", 0.0

    def count(took: float = 0.0) -> int:
        times = iter((now, now + took))
        return addon.capture_folder.last_look_into(photos, lambda: next(times)).photos

    assert count() == 6
    camera_engine.write_photos(photos, 8)
    now = 1.9
    assert count() == 6
    now = 2.1
    assert count(took=1.0) == 8
    camera_engine.write_photos(photos, 9)
    now = 32.0
    assert count() == 8
    addon.capture_folder.forget_looks()
    assert count() == 9


if __name__ == "__main__":
    sys.path.insert(0, str(Path(sys.argv[2]) / "package"))
    globals()[sys.argv[1]](Path(sys.argv[2]), *sys.argv[3:])
